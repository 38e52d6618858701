/*
 * Columns as low-rank corrections of all models of a group (matrix inversion lemma).
 */

#ifndef KINPOLE_COLUMNS_H
#define KINPOLE_COLUMNS_H

#include "lanes.h"
#include "models.h"
#include "private.h"
#include "sets.h"

/* Compute by how much the columns reduce the residual sums of squares of a group's models, and half
   of what they add to the log determinant (matrix inversion lemma: Rasmussen and Williams, A.3). */
PRIVATE void apply_columns(const Models *m, long long group, const Work *w, const Set *set,
                           Lanes *reduction, Lanes *logs);

/* Correct the derivatives (3, orders) of a group and their covariances for the columns. The effect
   of a column of size 1 on the derivatives, by which its estimated size is subtracted, is what the
   model makes of the column, less the derivatives of the step itself at the instant. `variance` is
   that of the noise times the weight in the covariance. */
PRIVATE void correct_for_columns(const Models *m, const Stencils *s, long long group, const Work *w,
                                 const Set *set, const Lanes *variance, Lanes *derivatives,
                                 Lanes *spread);

#endif
