/*
 * The motion of bodies, and the quantities that follow from it.
 */

#include <complex.h>

#define HIGHEST 4
typedef double complex Number;

/* What a quantity is: a pole of order 1 to 4, FREE plus that order for the pole by the motion alone, the
   velocity of the ICR, or the curvature of the centrode. */
enum { VELOCITY = HIGHEST + 1, CURVATURE, FREE = 10 };
/* Bits of the flags: see quantities.py. */
enum { DETERMINED = 1, MOVES = 2 };

/* Arrays of `count` elements, each a body at an instant; elements of two orders are `stride` apart. See
   quantities.py. */
typedef struct {
    long long count, stride, orders;
    const Number *position;
    const double *angle, *of_position, *of_angle, *size;
    const Number *pin;
    const double *pin_variance;
    const Number *reference;
    const double *height;
    const long long *stamp; /* of instants */
} Motion;

/* A quantity of one body at one instant: covariance xx, xy and yy, or a variance. */
typedef struct {
    Number value;
    double spread[3];
    int flags;
} Quantity;

/* Of the body and instant `t`, or of `j` with respect to `i`. */
Quantity kinpole_rate(const Motion *m, long long t, int order);
Quantity kinpole_quantity(const Motion *m, long long t, int what);
Quantity kinpole_relative_rate(const Motion *m, long long j, long long i);
Quantity kinpole_relative_center(const Motion *m, long long j, long long i);
