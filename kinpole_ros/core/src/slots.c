/*
 * Points of messages in the slots of the bodies, in meters and in the plane of the motion.
 */

#include <math.h>
#include <string.h>

#include "../include/messages.h"

/* Writes the point `row` of the `points` (P, 3) of a frame, in the unit `scale`, to `point` (3), m;
   NaN if it is none, is not finite, or is too far. Returns whether it is too far. */
static int
write_point(const Slots *slots, const double *points, long long row, double *point)
{
    int is_finite = row < slots->point_count, is_near = is_finite;
    for (int i = 0; i < 3 && is_finite; i++) {
        is_finite = isfinite(points[3 * row + i]);
        point[i] = points[3 * row + i] * slots->scale;
        is_near &= fabs(point[i]) < slots->farthest;
    }
    if (!(is_finite && is_near))
        point[0] = point[1] = point[2] = NAN;
    return is_finite && !is_near;
}

long long
kinpole_assign(const Slots *slots, const double *points, long long frames, double *flat,
               double *heights, double *in_space)
{
    const long long *axes = slots->axes;
    long long too_far = 0;
    for (long long at = 0; at < frames * slots->slots; at++) {
        double p[3], turned[3];
        const double *frame = points + at / slots->slots * slots->point_count * 3;
        too_far += write_point(slots, frame, slots->row_of_slot[at % slots->slots], p);
        if (in_space) {
            memcpy(in_space + 3 * at, p, sizeof p);
            continue;
        }
        for (int i = 0; i < 3; i++) {
            const double *e = slots->basis + 3 * i;
            turned[i] = slots->has_axes ? p[axes[i]] : p[0] * e[0] + p[1] * e[1] + p[2] * e[2];
        }
        flat[2 * at] = turned[0], flat[2 * at + 1] = turned[1], heights[at] = turned[2];
    }
    return too_far;
}
