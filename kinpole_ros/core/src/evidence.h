/*
 * Evidence of all models of a window of even samples, and mean and covariance of its derivatives.
 *
 * A model is a signal x = line + process + noise, with a process of covariance a^2 K and noise of
 * variance v. _models.py diagonalizes K on the window: with the coefficients c_r of the samples in
 * its modes, of singular values s_r, and the shrinkage k_r = a^2 s_r^2 / (1 + a^2 s_r^2),
 *
 *   residual    R = sum of x^2 - sum of k_r c_r^2
 *   variance    v = (R + n0) / (n0 + n), of n samples and a noise prior of n0 samples, unit noise
 *   evidence    log prior + sum of log(1 - k_r) / 2 - (n0 + n) / 2 log v
 *   derivative  sum of k_r c_r d_r, of the derivatives d_r of the modes at the instant
 *
 * (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, 2.7 and 5.4). Samples of
 * low weight, and steps, are columns: low-rank corrections of all of these (there, A.3).
 *
 * The LANES amplitudes a of a process are a group, side by side in all arrays; a process with more
 * has several groups. A lane without a model has evidence -infinity. Each process has modes of its
 * own, even and odd about the middle of the window; the first of each are mean and slope. The last
 * process is rest, which has the mean only.
 *
 * Index c is 0 for the angle and 1 for the position, or 1 and 2 for its coordinates. The two
 * coordinates share the evidence, so all of their sums count twice: (c + 1).
 */

#ifndef KINPOLE_EVIDENCE_H
#define KINPOLE_EVIDENCE_H

#include "models.h"

/* Correct the `derivatives` (3, orders) of a group's models and the lower triangles of `covariance`
   (2, orders, orders), for the columns of a set, after `evaluate_models`. The effect of a column of
   size 1 on the derivatives, by which its estimated size is subtracted, is what the model makes of
   the column, less the derivatives of the step itself at the instant. `variance` (2) is that of the
   noise times the weight in the covariance. */
PRIVATE void correct_for_columns(const Models *m, const Stencils *stencils, long long group,
                                 const Work *w, const Set *set, const Lanes *variance,
                                 Lanes *derivatives, Lanes *covariance);

/* Compute the coefficients and squares of samples, and the residual sum of squares of each model
   without columns. Writes these to `w`. */
PRIVATE void project_samples(const Models *m, const Samples *s, Work *w);

/* Compute the evidence of all models with the columns of a set, and the variance of their noise,
   after `project_samples`. Writes `evidence`, `best_evidence`, `variance`, and what belongs to the
   columns: `column_products`, `factors`, `residuals` and the coefficients of steps. The evidence of
   models with the spectrum of the body waits in `of_body`, and is -infinity so far. With steps,
   lengths shorter than one whose evidence is far below that of a longer one are left out, with an
   evidence of -infinity: theirs is lower still. */
PRIVATE void evaluate_models(const Models *m, const Samples *s, const Work *w, Set *set);

/* Let the models with the spectrum of the body count in all of `number` sets, and what it says of
   rest. */
PRIVATE void add_body(const Models *m, Set *sets, int number);

/* Compute the `probability` of all models with all of `number` sets, of angle (c = 0) or position
   (c = 1), from their evidence. Those of all sets add up to 1. Returns the log evidence of all. */
PRIVATE double find_probabilities(const Models *m, int c, Set *sets, int number);

/* Compute the `covariance_weight` of all models with all of `number` sets, of angle (c = 0) or
   position (c = 1): square roots of the evidence, with half of the log prior of events. All spectra
   have the same total, each with the models that are common to all, because samples contain no
   information on harmonics below the noise. */
PRIVATE void find_covariance_weights(const Models *m, int c, Set *sets, int number);

#endif
