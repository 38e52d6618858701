#ifndef KINPOLE_JOINTS_H
#define KINPOLE_JOINTS_H

#include "motion.h"

/* Joints of the second body against the first, -1 for the ground. The name of joint k, with its
   terminating zero, is that from `ends[k]` to `ends[k + 1]`. See _joints.py. */
#define JOINTS_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, number)               \
    VALUE(long long, bodies)               \
    VALUE(long long, is_deviation)         \
    VALUE(long long, size)                 \
    ARRAY(const long long, first)          \
    ARRAY(const long long, second)         \
    ARRAY(const long long, ends)           \
    ARRAY(const unsigned char, names)

typedef STRUCT(JOINTS_FIELDS) Joints;

API void kinpole_write_joints(const Motion *motion, const Joints *joints, const long long *stamps,
                              const long long *nearest, long long count, unsigned char *out,
                              long long *lengths);

#endif
