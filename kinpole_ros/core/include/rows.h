#ifndef KINPOLE_ROWS_H
#define KINPOLE_ROWS_H

#include "motion.h"

/* The messages of a topic, of a body, or of `other` with respect to it. A message has `size` bytes, of
   which the doubles begin behind `head`. `value`, `spread` (T, 2, 2) and `determined` are GIVEN. */
#define ROW_FIELDS(VALUE, BLOCK, ARRAY)  \
    VALUE(long long, kind)               \
    VALUE(long long, what)               \
    VALUE(long long, body)               \
    VALUE(long long, other)              \
    VALUE(long long, is_deviation)       \
    VALUE(long long, head)               \
    VALUE(long long, size)               \
    ARRAY(const unsigned char, template) \
    ARRAY(const Number, value)           \
    ARRAY(const double, spread)          \
    ARRAY(const unsigned char, determined)

typedef STRUCT(ROW_FIELDS) Row;

/* The rows e1, e2 and normal of the basis, and the variance of what the plane says nothing about. */
typedef double Axis[3];
#define PLANE_FIELDS(VALUE, BLOCK, ARRAY) \
    BLOCK(Axis, basis, 3)                 \
    VALUE(double, unmeasured)

typedef STRUCT(PLANE_FIELDS) Plane;

API void kinpole_write_rows(const Motion *motion, long long bodies, const Plane *plane, const Row *rows,
                            long long number, unsigned char *out, unsigned char *made);

#endif
