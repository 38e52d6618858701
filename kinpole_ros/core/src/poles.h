/*
 * Quantities of one body at one instant, or of one body relative to another.
 */

#ifndef KINPOLE_POLES_H
#define KINPOLE_POLES_H

#include "../include/motion.h"

/* A quantity of one body at one instant: covariance xx, xy and yy, or a variance, and why it is
   undetermined, of `REASONS`. */
typedef struct {
    Number value;
    double spread[3];
    int flags, reason;
} Quantity;

/* Whether anything is known of a body at an instant. */
int kinpole_is_known(const Motion *m, long long t);
/* Why nothing is known of a body at an instant. */
int kinpole_missing(const Motion *m, long long t);
/* Of the body and instant `t`, or of `j` with respect to `i`; relative ones have no reason. */
Quantity kinpole_rate(const Motion *m, long long t, int order);
Quantity kinpole_quantity(const Motion *m, long long t, int what);
Quantity kinpole_relative_rate(const Motion *m, long long j, long long i);
Quantity kinpole_relative_center(const Motion *m, long long j, long long i);

#endif
