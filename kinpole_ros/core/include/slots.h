#ifndef KINPOLE_ASSIGN_H
#define KINPOLE_ASSIGN_H

#include "structs.h"

/* Slot k of `count` takes row `rows[k]` of the `points` of a frame; none from row `points` on. Points
   are scaled, and those not nearer than `farthest`, m, are NaN. The plane is that of plane.py: without
   `axes` its basis counts. See placing.py. */
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

API long long kinpole_assign(const Slots *slots, const double *points, long long frames, double *flat,
                             double *heights, double *in_space);

#endif
