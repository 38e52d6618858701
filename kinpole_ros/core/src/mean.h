/*
 * The mean over all models, and its covariance; uneven samples moved to the even grid along it.
 */

#ifndef KINPOLE_MEAN_H
#define KINPOLE_MEAN_H

#include "models.h"


/* The result at an instant: derivatives, their covariances, of the angle and of one coordinate, the
   effective number of parameters of the motion of the angle, log evidence, and where the point is
   whose position this is, while the angle is 0 (0 for the given position). */
typedef struct {
    double mean[3][MAX_ORDERS], covariance[2][MAX_ORDERS][MAX_ORDERS], freedom, evidence[2];
    Number hub;
} Estimate;

/* Differentiate samples: the mean over all models with all sets by their probabilities, and its
   covariance, the weighted mean of those of the models, plus the variance between the models, plus
   that of the places of the events. */
PRIVATE void differentiate(const Models *m, const Stencils *s, const Work *w, Set *sets, int number,
                           Estimate *out);

/* Move the samples `given` to the even grid: subtract the Taylor series, up to SLOPE_ORDERS, of the
   motion that is estimated from the samples `placed` in the previous round. `slopes` (SLOPE_ORDERS,
   panels of LANES, rows) are the derivatives of the modes at the first half of the samples. Missing
   samples move to their prediction from the others. */
PRIVATE void move_to_grid(const Models *m, const Lanes *slopes, const Samples *given,
                          const Samples *placed, Work *w, Set *set, double *const moved[3]);

#endif
