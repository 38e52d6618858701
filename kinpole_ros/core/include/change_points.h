/*
 * The search of the events that are reported: where a derivative of a pose steps.
 */

#ifndef KINPOLE_CHANGE_POINTS_H
#define KINPOLE_CHANGE_POINTS_H

#include "structs.h"

/* An event: the log evidence for it, when it is and the deviation of that, intervals, which
   derivative steps, by how much, and the deviations of these. */
typedef struct {
    double gain, place, place_sigma, order, size[3], size_sigma[3];
} ChangePoint;

/* Find the likeliest event at most `radius` from `offset`. Samples of an angle and of both
   coordinates of a point, `values` (3, count), are in deviations of their noise, and their
   `time` (count) rises by about 1. In the longest window motion goes on until `after`, and for
   twice as long before 0. Returns 1 if there is an event, 0 if smooth motion explains the
   samples as well, and -1 without memory. */
API int kinpole_find_event(const double *time, const double *values, long long count,
                           long long after, double offset, double radius, ChangePoint *found);

#endif
