/*
 * The mean over all models, and its covariance.
 */

#ifndef KINPOLE_MEAN_H
#define KINPOLE_MEAN_H

#include "models.h"
#include "private.h"
#include "sets.h"

/* The result at an instant: derivatives, their covariances, of the angle and of one coordinate, and
   the effective number of parameters of the motion. */
typedef struct {
    double mean[3][MAX_ORDERS], covariance[2][MAX_ORDERS][MAX_ORDERS], freedom[2];
} Estimate;

/* Differentiate samples: the mean over all models with all sets by their probabilities, and its
   covariance, the weighted mean of those of the models, plus the variance between the models, plus
   that of the places of the events. */
PRIVATE void differentiate(const Models *m, const Stencils *s, const Work *w, Set *sets, int number,
                           Estimate *out);

#endif
