/*
 * Low polynomials between events: the simplest motions, as free flight between impacts or turning
 * between stops.
 *
 * The window is divided into segments, two or more: without an event the models have more to say.
 * In each segment a signal is a polynomial of its own. The log evidence of a division is the sum
 * over its segments of
 *
 *   -(residual sum of squares) / 2 - COEFFICIENT_COST (coefficients) - EVENT_COST
 *
 * and dynamic programming finds the best sums before and after each sample, so the best division
 * with any segment around the instant is known (Jackson and others, An algorithm for optimal
 * partitioning of data on an interval, 2005). The result is the mean over these segments. The
 * polynomials of all segments of a length are fitted side by side, by Givens rotations: each sample
 * is rotated into the triangular factors of the segments that it extends.
 */

#ifndef KINPOLE_SEGMENTS_H
#define KINPOLE_SEGMENTS_H

#include "mean.h"

/* Divide a window into segments, and mix their derivatives into those of the models, `estimate`, by
   the evidence of both, part by part. Its `evidence` becomes the larger. Segments far behind the
   models change nothing. Returns DONE or NO_MEMORY. */
PRIVATE int add_segments(Call *call, const Stencils *stencils, const Samples *s,
                         Estimate *estimate);

#endif
