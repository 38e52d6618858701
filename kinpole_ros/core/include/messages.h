/*
 * Points read from messages, and messages written.
 *
 * Shapes have T frames or instants, B bodies, and the S slots of all markers.
 */

#ifndef KINPOLE_MESSAGES_H
#define KINPOLE_MESSAGES_H

#include <stddef.h>

#include "motion.h"

/* Which point of a frame each slot takes, and the plane of the motion, that of plane.py: see
   placing.py. */
#define SLOTS_FIELDS(VALUE, BLOCK, ARRAY)                                                  \
    VALUE(long long, slots, "S")                                                           \
    VALUE(long long, point_count, "P: points of a frame")                                  \
    VALUE(long long, has_axes, "1 if the axes of the plane are axes of the points")        \
    BLOCK(long long, axes, 3, "the coordinates that are x, y and height, with `has_axes`") \
    VALUE(double, scale, "m: the unit of the points")                                      \
    VALUE(double, farthest, "m: a point with a coordinate that is not below this is NaN")  \
    BLOCK(double, basis, 9, "rows e1, e2 and normal of the plane, without `has_axes`")     \
    ARRAY(const long long, row_of_slot, "(S)", "the point of each slot; P or more for none")

typedef STRUCT(SLOTS_FIELDS) Slots;

/* Puts the `points` (T, P, 3) of frames into the slots. Writes them to `in_space` (T, S, 3), m. If
   that is NULL, writes x and y in the plane to `flat` (T, S, 2), and `heights` (T, S), m. Slots
   without a point are NaN. Returns how many points are too far. */
API long long kinpole_assign(const Slots *slots, const double *points, long long frames,
                             double *flat, double *heights, double *in_space);

/* Where messages of one layout have their numbers: see _points.py. */
#define MESSAGE_LAYOUT_FIELDS(VALUE, BLOCK, ARRAY)                                           \
    VALUE(long long, message_bytes, "length of a message")                                   \
    VALUE(long long, compared, "C: bytes in which messages of this layout agree with `key`") \
    VALUE(long long, stamp_offset, "byte at which the stamp begins")                         \
    VALUE(long long, is_stamp_big_endian, "1 if its first byte is the highest")              \
    VALUE(long long, end_of_time, "ns: stamps are before this")                              \
    VALUE(long long, point_count, "P: points of a message")                                  \
    VALUE(long long, is_big_endian, "1 if the first byte of a coordinate is the highest")    \
    BLOCK(long long, axis_offsets, 3, "bytes from the begin of a point to each coordinate")  \
    BLOCK(long long, axis_widths, 3, "bytes of each coordinate, 4 or 8; 0: it is 0")         \
    ARRAY(const unsigned char, mask, "(C)", "bits that are compared")                        \
    ARRAY(const unsigned char, key, "(C)", "what they are")                                  \
    ARRAY(const long long, point_offsets, "(P)", "byte at which each point begins")

typedef STRUCT(MESSAGE_LAYOUT_FIELDS) MessageLayout;

/* Returns how many of the `messages` from `first` to before `end` are of the layout, up to the
   first that is not. */
API long long kinpole_count_matches(const MessageLayout *layout, const unsigned char *messages,
                                    long long first, long long end);
/* Reads the messages from `first` to before `end`, which are of the layout. Writes `stamps` (T),
   ns, and `points` (T, P, 3), in the unit of the messages; one with a coordinate that is not finite
   is NaN. */
API void kinpole_read_messages(const MessageLayout *layout, const unsigned char *messages,
                               long long first, long long end, long long *stamps, double *points);

/* The messages of a topic, of a body or of a pair of bodies, or those of the topic `state`: see
   _rows.py. */
#define ROW_FIELDS(VALUE, BLOCK, ARRAY)                                               \
    VALUE(long long, kind, "MESSAGE_KINDS: what the message is")                      \
    VALUE(long long, quantity, "QUANTITIES: what it is of; 0 if its kind says so")    \
    VALUE(long long, order, "highest derivative in a message of the topic `state`")   \
    VALUE(long long, body, "the body, or that with respect to which `other` is")      \
    VALUE(long long, other, "the second body of a pair")                              \
    VALUE(long long, is_deviation, "1 for the standard deviation of the quantity")    \
    VALUE(long long, added_count, "A: numbers of each body behind its reasons")       \
    VALUE(long long, head, "bytes before the doubles of the message")                 \
    VALUE(long long, message_bytes, "length of a message")                            \
    ARRAY(const unsigned char, template, "(message_bytes)", "the message with zeros") \
    ARRAY(const Number, value, "(T)", "the quantity, if it is GIVEN")                 \
    ARRAY(const double, covariance, "(T, 2, 2)", "its covariance")                    \
    ARRAY(const Flag, determined, "(T)", "whether it is determined")                  \
    ARRAY(const double, added, "(T, B, A)", "numbers behind the reasons of a body, in `state`")

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

#define MESSAGE_DOUBLES(CODE)                                                      \
    CODE(VECTOR_DOUBLES, 3)                                                        \
    CODE(FRAME_DOUBLES, (int)(offsetof(PoseDoubles, covariance) / sizeof(double))) \
    CODE(POSE_DOUBLES, (int)(sizeof(PoseDoubles) / sizeof(double)))                \
    CODE(ODOMETRY_DOUBLES, (int)(sizeof(OdometryDoubles) / sizeof(double)))

enum { MESSAGE_DOUBLES(DECLARE_CODE) };

/* The plane of the motion in space. */
typedef double Axis[3];
#define PLANE_FIELDS(VALUE, BLOCK, ARRAY)                        \
    BLOCK(Axis, basis, 3, "rows e1, e2 and normal of the plane") \
    VALUE(double, unmeasured, "m^2 or rad^2: variance of what the plane says nothing about")

typedef STRUCT(PLANE_FIELDS) Plane;

/* Writes the messages of `number` rows, of all instants of each, one after the other, to `out`.
   `motion` has so many `bodies` at each instant. Writes to `made` (rows, T) whether there is one;
   the bytes of others mean nothing. */
API void kinpole_write_rows(const Motion *motion, long long bodies, const Plane *plane,
                            const Row *rows, long long number, unsigned char *out,
                            unsigned char *made);

/* The joints of joint states: see _joints.py. */
#define JOINTS_FIELDS(VALUE, BLOCK, ARRAY)                                               \
    VALUE(long long, joints, "J")                                                        \
    VALUE(long long, bodies, "B")                                                        \
    VALUE(long long, is_deviation, "1 for standard deviations of the states")            \
    VALUE(long long, message_bytes, "most bytes of a message")                           \
    ARRAY(const long long, first_body, "(J)", "fixed body; -1: the ground")              \
    ARRAY(const long long, second_body, "(J)", "moving body; -1: the ground")            \
    ARRAY(const long long, ends, "(J + 1)", "where each name begins, and the last ends") \
    ARRAY(const unsigned char, names, "(bytes)", "names, each with its terminating zero")

typedef STRUCT(JOINTS_FIELDS) Joints;

/* Writes `count` messages to `out` (count, message_bytes), and their `lengths` (count), bytes; 0
   for none. Each has the states at one of `stamps` (count), ns, by the derivatives at the instant
   `nearest` (count), extrapolated. */
API void kinpole_write_joints(const Motion *motion, const Joints *joints, const long long *stamps,
                              const long long *nearest, long long count, unsigned char *out,
                              long long *lengths);

#endif
