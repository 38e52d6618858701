/*
 * The mean over all models, and its covariance; uneven samples moved to the even grid along it.
 */

#ifndef KINPOLE_MEAN_H
#define KINPOLE_MEAN_H

#include "models.h"

/* The result at an instant, (orders) of each. */
typedef struct {
    double mean[3][MAX_ORDERS];                   /* derivatives of the signals */
    double covariance[2][MAX_ORDERS][MAX_ORDERS]; /* of the angle, and of one coordinate */
    double parameters;  /* effective number of parameters of the motion of the angle */
    double evidence[2]; /* log evidence of all models */
    double event[2];    /* probability that the window has an event */
    Number hub; /* from the position of the samples to that of `mean`, while the angle is 0 */
} Estimate;

/* Differentiate samples at the instant of the stencils, with `number` sets of `evaluate_models`, of
   which the first has no event:
   the mean over all models with all sets by their probabilities, and its covariance, the weighted
   mean of those of the models, plus the variance between the models, plus that of the places of the
   events. Writes `out`, with a `hub` of 0, and of the sets `probability`, `covariance_weight`,
   `derivatives` and `is_used`. */
PRIVATE void differentiate(const Models *m, const Stencils *stencils, const Work *w, Set *sets,
                           int number, Estimate *out);

/* Move the samples `uneven` to the even grid, into `moved` (3, count): subtract the Taylor series,
   up to SLOPE_ORDERS, of the motion that is estimated from the samples `placed` in the previous
   round. `slopes` (SLOPE_ORDERS, panels of LANES, rows) are the derivatives of the modes at the
   first half of the samples. Missing samples move to their prediction from the others. `w` and
   `set`, which has no steps, get what they have of `placed`. */
PRIVATE void move_to_grid(const Models *m, const Lanes *slopes, const Samples *uneven,
                          const Samples *placed, Work *w, Set *set, double *const moved[3]);

#endif
