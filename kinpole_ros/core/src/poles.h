/*
 * Quantities of one body at one instant, or of one body relative to another.
 */

#ifndef KINPOLE_POLES_H
#define KINPOLE_POLES_H

#include "../include/motion.h"

/* A quantity of one pose, a body at an instant. */
typedef struct {
    Number value;         /* m, m/s, 1/m or rad/s^k; real for a scalar */
    double covariance[3]; /* xx, xy and yy, in the square of this unit; a scalar has xx alone */
    int flags;            /* QUANTITY_FLAGS */
    int reason;           /* REASONS: why it is undetermined; of one body only */
} Quantity;

/* Whether pose `t` of a motion has a finite rate and velocity, so anything is known of it. */
int kinpole_is_known(const Motion *m, long long t);
/* Why pose `t` has no result, one of REASONS; KNOWN if it has one, or if `m` has no reasons. */
int kinpole_missing(const Motion *m, long long t);
/* From the origin of the body's frame in pose `t` to the point whose position is derived, m. */
Number kinpole_arm(const Motion *m, long long t);
/* The derivative of an order, 1 or more, of the angle of pose `t`, rad/s^k, determined where it is
   finite. */
Quantity kinpole_rate(const Motion *m, long long t, int order);
/* The quantity of pose `t` with this code of QUANTITIES, up to RATE_4; NaN for another code. */
Quantity kinpole_quantity(const Motion *m, long long t, int quantity);
/* The rate of pose `j` with respect to pose `i`, rad/s, of two bodies at one instant, determined
   where it is finite. */
Quantity kinpole_relative_rate(const Motion *m, long long j, long long i);
/* The instant center of pose `j` with respect to pose `i`, m: (q_j - q_i) / (i (w_j - w_i)) with q
   = i w z - v of each, for position z, velocity v and rate w. It is determined if the relative rate
   exceeds SIGNIFICANT standard deviations, and the center is near. See `relative_center` in
   planar/. */
Quantity kinpole_relative_center(const Motion *m, long long j, long long i);

#endif
