/*
 * The search of the events that are reported: where a derivative of a pose steps.
 */

#ifndef KINPOLE_CHANGE_POINTS_H
#define KINPOLE_CHANGE_POINTS_H

#include "codes.h"

/* An event. Times are in intervals between samples, signals in deviations of their noise. */
#define CHANGE_POINT_FIELDS(VALUE, BLOCK, ARRAY)                                           \
    VALUE(double, gain, "log evidence for it")                                             \
    VALUE(double, place, "intervals: when it is")                                          \
    VALUE(double, place_sigma, "intervals: standard deviation of this")                    \
    VALUE(double, step_order, "order of the derivative that steps, 0 for the pose itself") \
    BLOCK(double, step, 3, "by how much it steps: of the angle, and of both coordinates")  \
    BLOCK(double, step_sigma, 3, "standard deviations of these")

typedef STRUCT(CHANGE_POINT_FIELDS) ChangePoint;

/* Finds an event at most `radius` from `offset`, both in intervals, as the rising times `time`
   (count) of samples, which are about 1 apart: that of the shortest window that shows one.
   `values` (3, count) are an angle and both coordinates of a point, in deviations of their noise.
   The windows that are searched are about time 0: the longest goes on for `after` intervals after
   it, and begins twice as long before it. Returns 1 if there is an event, and writes it to `found`;
   0 if smooth motion explains the samples as well, or they are too few; -1 without memory. */
API int kinpole_find_event(const double *time, const double *values, long long count,
                           long long after, double offset, double radius, ChangePoint *found);

#endif
