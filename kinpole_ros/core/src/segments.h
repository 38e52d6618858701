/*
 * Low polynomials between events: the simplest motions, as free flight between impacts or turning
 * between stops.
 *
 * The window is divided into segments, and in each of these a signal is a polynomial of its own.
 * The log evidence of a division is the sum over its segments of
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

/* All segments of a window. Part 0 is the angle, part 1 the position. */
typedef struct {
    long long count;    /* samples; 0 if the window is not divided */
    double *root;       /* (count): of the smaller weight of each sample */
    double *present;    /* (count + 1): how many samples before each one are not missing */
    double *value[2];   /* (count, count): log evidence, by length less one and first sample */
    double *before[2];  /* (count + 1): the best log evidence of the samples before each one */
    double *after[2];   /* (count + 1): that of the samples from each one on */
    double excess[2];   /* log size of the samples, over COEFFICIENT_COST, if this is more */
    double evidence[2]; /* of the best division, over that of noise alone */
    double *scratch;    /* at least (COLUMNS + 3, count) */
} Division;

/* Divide a window into segments. Writes `d`, whose memory the next call uses again. Returns DONE or
   NO_MEMORY. */
PRIVATE int divide_window(Call *call, const Samples *s, Division *d);

/* Return the sample after the event that is nearest to the instant `at`, samples after the first,
   in the best division, that of the angle or of the position, if its evidence is more than that of
   models without events (`none`); -1 otherwise. */
PRIVATE long long nearest_event(const Division *d, const Set *none, double at);

/* Estimate the derivatives by segments, and mix them into those of the models, `estimate`, by the
   evidence of both, part by part. Its `evidence` becomes the larger. Segments far behind the models
   change nothing. */
PRIVATE void add_segments(const Stencils *stencils, const Samples *s, const Division *d,
                          Estimate *estimate);

#endif
