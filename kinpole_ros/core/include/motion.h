/*
 * The motion of bodies, and the quantities that follow from it.
 */

#ifndef KINPOLE_QUANTITIES_H
#define KINPOLE_QUANTITIES_H

#include "codes.h"
#include "structs.h"

/* Arrays of `count` elements, each a body at an instant; elements of two orders are `stride` apart.
   The stamps are of instants. `reason` says why a body has no result; without it all have one. See
   quantities.py. */
#define MOTION_FIELDS(VALUE, BLOCK, ARRAY)   \
    VALUE(long long, count)                  \
    VALUE(long long, stride)                 \
    VALUE(long long, orders)                 \
    ARRAY(const Number, position)            \
    ARRAY(const double, angle)               \
    ARRAY(const double, position_covariance) \
    ARRAY(const double, angle_covariance)    \
    ARRAY(const double, size)                \
    ARRAY(const Number, pin)                 \
    ARRAY(const double, pin_variance)        \
    ARRAY(const Number, reference)           \
    ARRAY(const double, height)              \
    ARRAY(const long long, stamp)            \
    ARRAY(const unsigned char, reason)

typedef STRUCT(MOTION_FIELDS) Motion;

API void kinpole_quantities(int what, const Motion *m, Number *values, double *spreads,
                            unsigned char *flags, unsigned char *reasons);
API void kinpole_relative_centers(const Motion *m, long long bodies, const long long *pairs,
                                  long long number, Number *values, double *spreads,
                                  unsigned char *flags);

#endif
