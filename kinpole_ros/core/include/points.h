#ifndef KINPOLE_POINTS_H
#define KINPOLE_POINTS_H

#include "structs.h"

/* Messages of `size` bytes that agree with `key` where `mask` has bits, both of `compared` bytes. The
   stamp is at byte `stamp`, and before `end_of_time`, ns. Point k of `count` begins at byte
   `points[k]`. Its coordinates begin `axes` bytes behind that, and are floats of `widths` bytes, 4 or
   8; one of width 0 is 0. See _points.py. */
#define MESSAGE_LAYOUT_FIELDS(VALUE, BLOCK, ARRAY) \
    VALUE(long long, size)                         \
    VALUE(long long, compared)                     \
    VALUE(long long, stamp)                        \
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
API void kinpole_read_points(const MessageLayout *layout, const unsigned char *message, double *points);
API void kinpole_read_messages(const MessageLayout *layout, const unsigned char *messages, long long first,
                               long long count, long long *stamps, double *points);

#endif
