/*
 * The motion of bodies, and the quantities that follow from it.
 *
 * Shapes have K derivatives, from order 0 on, of B bodies at T instants. A pose is a body at an
 * instant. Covariances are between derivatives of order k and l.
 */

#ifndef KINPOLE_MOTION_H
#define KINPOLE_MOTION_H

#include "codes.h"

/* Elements of two orders are `stride` apart, which is T B or more: see quantities.py. */
#define MOTION_FIELDS(VALUE, BLOCK, ARRAY)                                                       \
    VALUE(long long, poses, "T B")                                                               \
    VALUE(long long, stride, "elements from one order to the next")                              \
    VALUE(long long, orders, "K")                                                                \
    ARRAY(const Number, position, "(K, T, B)", "m/s^k: derivatives of the position")             \
    ARRAY(const double, angle, "(K, T, B)", "rad/s^k: derivatives of the angle")                 \
    ARRAY(const double, position_covariance, "(K, K, T, B)", "m^2/s^(k + l): of one coordinate") \
    ARRAY(const double, angle_covariance, "(K, K, T, B)", "rad^2/s^(k + l): of the angle")       \
    ARRAY(const double, size, "(T, B)", "m: diameter of the body")                               \
    ARRAY(const Number, pin, "(T, B)", "m: fixed point that the body turns about; NaN for none") \
    ARRAY(const double, pin_variance, "(T, B)", "m^2: variance of a coordinate of the pin")      \
    ARRAY(const Number, reference, "(T, B)", "m: point of this position, in the body frame")     \
    ARRAY(const double, height, "(T, B)", "m: mean height of the markers seen")                  \
    ARRAY(const long long, stamp, "(T)", "ns: the instant, a stamp")                             \
    ARRAY(const unsigned char, reason, "(T, B)", "REASONS: why there is no result; NULL: none")

typedef STRUCT(MOTION_FIELDS) Motion;

/* Computes a quantity of QUANTITIES of all poses. Writes `values` (T, B), m, m/s, 1/m or rad/s^k,
   their `covariances` (T, B, 2, 2), `flags` (T, B), QUANTITY_FLAGS, and `reasons` (T, B), REASONS.
   The covariance of a real quantity is its variance, in the first element. */
API void kinpole_quantities(int quantity, const Motion *m, Number *values, double *covariances,
                            unsigned char *flags, unsigned char *reasons);
/* Computes the origins of the frames of the bodies of all poses, m, in `origins` (T, B). */
API void kinpole_origins(const Motion *m, Number *origins);
/* Computes the instant center of body j with respect to body i, of so many `bodies`, for the
   `number` P of `pairs` (2, P): all j, then all i. Writes `values` (T, P), m, `covariances` (T, P,
   2, 2), and `flags` (T, P). */
API void kinpole_relative_centers(const Motion *m, long long bodies, const long long *pairs,
                                  long long number, Number *values, double *covariances,
                                  unsigned char *flags);

#endif
