/*
 * Uneven samples moved to the even grid along the mean of the models.
 */

#ifndef KINPOLE_MOVING_H
#define KINPOLE_MOVING_H

#include "lanes.h"
#include "models.h"
#include "private.h"
#include "samples.h"
#include "sets.h"

/* Derivatives by which samples are moved: as many as `slopes_of` of _models.py makes. */
#define SLOPE_ORDERS 4

/* Move the samples `given` to the even grid: subtract the Taylor series, up to SLOPE_ORDERS, of the
   motion that is estimated from the samples `placed` in the previous round. `slopes` (SLOPE_ORDERS,
   panels of LANES, rows) are the derivatives of the modes at the first half of the samples. Missing
   samples move to their prediction from the others. */
PRIVATE void move_to_grid(const Models *m, const Lanes *slopes, const Samples *given,
                          const Samples *placed, Work *w, Set *set, double *const moved[3]);

#endif
