/*
 * Points read from messages, and messages written.
 */

#ifndef KINPOLE_MESSAGES_H
#define KINPOLE_MESSAGES_H

#include <stddef.h>

#include "motion.h"
#include "structs.h"

/* Slot k of `count` takes row `rows[k]` of the `points` of a frame; none from row `points` on.
   Points are scaled, and those not nearer than `farthest`, m, are NaN. The plane is that of
   plane.py: without `axes` its basis counts. See placing.py. */
#define SLOTS_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, count)               \
    VALUE(long long, points)              \
    VALUE(long long, has_axes)            \
    BLOCK(long long, axes, 3)             \
    VALUE(double, scale)                  \
    VALUE(double, farthest)               \
    BLOCK(double, basis, 9)               \
    ARRAY(const long long, rows)

typedef STRUCT(SLOTS_FIELDS) Slots;

API long long kinpole_assign(const Slots *slots, const double *points, long long frames,
                             double *flat, double *heights, double *in_space);

/* Messages of `size` bytes that agree with `key` where `mask` has bits, both of `compared` bytes.
   The stamp is at byte `stamp`, and before `end_of_time`, ns. Point k of `count` begins at byte
   `points[k]`. Its coordinates begin `axes` bytes behind that, and are floats of `widths` bytes, 4
   or 8; one of width 0 is 0. See _points.py. */
#define MESSAGE_LAYOUT_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, size)                         \
    VALUE(long long, compared)                     \
    VALUE(long long, stamp)                        \
    VALUE(long long, is_stamp_big_endian)          \
    VALUE(long long, end_of_time)                  \
    VALUE(long long, count)                        \
    VALUE(long long, is_big_endian)                \
    BLOCK(long long, axes, 3)                      \
    BLOCK(long long, widths, 3)                    \
    ARRAY(const unsigned char, mask)               \
    ARRAY(const unsigned char, key)                \
    ARRAY(const long long, points)

typedef STRUCT(MESSAGE_LAYOUT_FIELDS) MessageLayout;

API long long kinpole_count_matches(const MessageLayout *layout, const unsigned char *messages,
                                    long long first, long long count);
API void kinpole_read_messages(const MessageLayout *layout, const unsigned char *messages,
                               long long first, long long count, long long *stamps,
                               double *points);

/* The messages of a topic, of a body, or of `other` with respect to it. A message has `size` bytes,
   of which the doubles begin behind `head`. `value`, `spread` (T, 2, 2) and `determined` are GIVEN.
   In the topic `state` the reasons follow the quantities of each body, a byte each, and then come
   `added` (T, bodies, `added_count`). */
#define ROW_FIELDS(VALUE, BLOCK, ARRAY)  \
    VALUE(long long, kind)               \
    VALUE(long long, what)               \
    VALUE(long long, body)               \
    VALUE(long long, other)              \
    VALUE(long long, is_deviation)       \
    VALUE(long long, added_count)        \
    VALUE(long long, head)               \
    VALUE(long long, size)               \
    ARRAY(const unsigned char, template) \
    ARRAY(const Number, value)           \
    ARRAY(const double, spread)          \
    ARRAY(const unsigned char, determined) \
    ARRAY(const double, added)

typedef STRUCT(ROW_FIELDS) Row;

/* The doubles of messages, in their order there: of a pose with covariance, and of odometry. The
   frame of /tf is the begin of a pose. */
typedef struct {
    double position[3], orientation[4], covariance[6][6];
} PoseDoubles;

typedef struct {
    double linear[3], angular[3], covariance[6][6];
} TwistDoubles;

typedef struct {
    PoseDoubles pose;
    TwistDoubles twist;
} OdometryDoubles;

#define MESSAGE_DOUBLES(CODE)                                                    \
    CODE(VECTOR_DOUBLES, 3)                                                      \
    CODE(FRAME_DOUBLES, (int)(offsetof(PoseDoubles, covariance) / sizeof(double))) \
    CODE(POSE_DOUBLES, (int)(sizeof(PoseDoubles) / sizeof(double)))              \
    CODE(ODOMETRY_DOUBLES, (int)(sizeof(OdometryDoubles) / sizeof(double)))

enum { MESSAGE_DOUBLES(DECLARE_CODE) };

/* The rows e1, e2 and normal of the basis, and the variance of what the plane says nothing
   about. */
typedef double Axis[3];
#define PLANE_FIELDS(VALUE, BLOCK, ARRAY) \
    BLOCK(Axis, basis, 3)                 \
    VALUE(double, unmeasured)

typedef STRUCT(PLANE_FIELDS) Plane;

API void kinpole_write_rows(const Motion *motion, long long bodies, const Plane *plane,
                            const Row *rows, long long number, unsigned char *out,
                            unsigned char *made);

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
