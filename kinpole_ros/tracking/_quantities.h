/*
 * The motion of bodies, and the quantities that follow from it.
 */

#ifndef KINPOLE_QUANTITIES_H
#define KINPOLE_QUANTITIES_H

#include "../core/include/structs.h"

#define HIGHEST 4

/* What a quantity is: a pole of order 1 to 4, FREE plus that order for the pole by the motion alone, the
   velocity of the ICR, or the curvature of the centrode. */
enum { VELOCITY = HIGHEST + 1, CURVATURE, FREE = 10 };
/* Bits of the flags: see quantities.py. */
enum { DETERMINED = 1, MOVES = 2 };

/* Arrays of `count` elements, each a body at an instant; elements of two orders are `stride` apart. The
   stamps are of instants. See quantities.py. */
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
    ARRAY(const long long, stamp)

typedef STRUCT(MOTION_FIELDS) Motion;

/* A quantity of one body at one instant: covariance xx, xy and yy, or a variance. */
typedef struct {
    Number value;
    double spread[3];
    int flags;
} Quantity;

/* Whether anything is known of a body at an instant. */
int kinpole_is_known(const Motion *m, long long t);
/* Of the body and instant `t`, or of `j` with respect to `i`. */
Quantity kinpole_rate(const Motion *m, long long t, int order);
Quantity kinpole_quantity(const Motion *m, long long t, int what);
Quantity kinpole_relative_rate(const Motion *m, long long j, long long i);
Quantity kinpole_relative_center(const Motion *m, long long j, long long i);
API void kinpole_quantities(int what, const Motion *m, Number *values, double *spreads,
                            unsigned char *flags);
API void kinpole_relative_centers(const Motion *m, long long bodies, const long long *pairs,
                                  long long number, Number *values, double *spreads,
                                  unsigned char *flags);

#endif
