/*
 * Stamps and points read from the bytes of marker messages of a known layout.
 */

#include <math.h>
#include <string.h>

#include "../include/messages.h"
#include "numbers.h"

/* The unsigned integer in `width` bytes, at most 8; big endian if the first is the highest. */
static inline unsigned long long
integer_at(const unsigned char *bytes, int width, int is_big_endian)
{
    unsigned long long value = 0;
    for (int k = 0; k < width; k++)
        value |= (unsigned long long)bytes[is_big_endian ? width - 1 - k : k] << 8 * k;
    return value;
}

/* The float in 4 bytes. */
static inline double
float_at(const unsigned char *bytes, int is_big_endian)
{
    unsigned int bits = (unsigned int)integer_at(bytes, 4, is_big_endian);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The double in 8 bytes. */
static inline double
double_at(const unsigned char *bytes, int is_big_endian)
{
    unsigned long long bits = integer_at(bytes, 8, is_big_endian);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The stamp of a message, ns. */
static long long
stamp_of(const MessageLayout *layout, const unsigned char *message)
{
    const unsigned char *stamp = message + layout->stamp_offset;
    int is_big_endian = layout->is_stamp_big_endian != 0;
    return (int)integer_at(stamp, 4, is_big_endian) * SECOND
        + (long long)integer_at(stamp + 4, 4, is_big_endian);
}

long long
kinpole_count_matches(const MessageLayout *layout, const unsigned char *messages, long long first,
                      long long end)
{
    messages += first * layout->message_bytes;
    for (long long t = first; t < end; t++, messages += layout->message_bytes) {
        unsigned char differs = 0;
        for (long long k = 0; k < layout->compared; k++)
            differs |= (messages[k] ^ layout->key[k]) & layout->mask[k];
        if (differs || stamp_of(layout, messages) >= layout->end_of_time)
            return t - first;
    }
    return end - first;
}

/* Reads the `points` (P, 3) of a message, in its unit. One with a coordinate that is not finite
   becomes NaN. */
static void
read_points(const MessageLayout *layout, const unsigned char *message, double *points)
{
    int is_big_endian = layout->is_big_endian != 0;
    for (long long k = 0; k < layout->point_count; k++, points += 3) {
        const unsigned char *point = message + layout->point_offsets[k];
        for (int i = 0; i < 3; i++) {
            const unsigned char *bytes = point + layout->axis_offsets[i];
            points[i] = layout->axis_widths[i] == 8 ? double_at(bytes, is_big_endian)
                : layout->axis_widths[i] == 4 ? float_at(bytes, is_big_endian) : 0.0;
        }
        if (!(isfinite(points[0]) && isfinite(points[1]) && isfinite(points[2])))
            points[0] = points[1] = points[2] = NAN;
    }
}

void
kinpole_read_messages(const MessageLayout *layout, const unsigned char *messages, long long first,
                      long long end, long long *stamps, double *points)
{
    messages += first * layout->message_bytes;
    for (long long t = 0; t < end - first; t++, messages += layout->message_bytes) {
        stamps[t] = stamp_of(layout, messages);
        read_points(layout, messages, points + 3 * t * layout->point_count);
    }
}
