/*
 * The models of a window, as _models.py makes them, and sums over their modes.
 */

#ifndef KINPOLE_MODELS_H
#define KINPOLE_MODELS_H

#include "lanes.h"
#include "private.h"

/* Derivatives of order 0 to 4. */
#define MAX_ORDERS 5

/* The models of a window of `count` samples, as `models_of` of _models.py makes them. */
typedef struct {
    long long count, half; /* samples, and those of the first half, with the middle */
    long long processes;
    long long chunks;  /* groups of each process */
    long long groups;  /* processes times chunks */
    long long spectra; /* with the rough one, which is the last */
    long long exact;   /* each process has as many modes as there are samples */
    long long rows;    /* modes of all processes, filled up to whole lanes: the even ones first */
    long long first_odd;
    const long long *first_row; /* (2, processes + 1), of the even and the odd modes of a process */
    const long long *spectrum;  /* of each model (groups, LANES); `spectra` if common to all */
    const Lanes *basis;         /* (rows / LANES, half): modes on the first half of the samples */
    const Lanes *shrinkage;     /* (chunks, rows) */
    const Lanes *residual_factor; /* 1 - shrinkage if exact, where a difference would be rounding;
                                     otherwise the shrinkage */
    const Lanes *log_prior;     /* (2, groups), plus (c + 1) sum of log(1 - shrinkage) / 2 */
    const Lanes *freedom;       /* (groups): sum of the shrinkage, the effective parameters */
    const double *step_squares; /* (models, STEP_ORDERS, count): b' P b, of a step b half a sample
                                   before each sample, and the inverse P of a model's covariance */
} Models;

/* The derivatives at an instant, as `stencils_of` of _models.py makes them. */
typedef struct {
    long long orders;
    double at;           /* the instant, samples after the first */
    const double *modes; /* (orders, rows): derivatives of the modes */
    const Lanes *spread; /* (groups, orders, orders): covariances for unit noise */
} Stencils;

/* Add to out[c] the sum over k < depth of table[k] values[c][k], for each of the columns c. Rows of
   `values` are `stride` apart, and elements of `out` are `step` apart. Three columns are summed at
   once, so that the processor need not wait for each sum. */
PRIVATE void add_table_products(const Lanes *table, long long depth, const double *values,
                                long long stride, long long columns, Lanes *out, long long step);

/* Add to `out` (a, b) the sums over the modes r of a group's process of table[r] left[i][r]
   right[j][r], for left (a, rows) and right (b, rows). Without `right` these are the pairs j <= i
   of left. */
PRIVATE void add_mode_products(const Models *m, const Lanes *table, long long group,
                               const double *left, long long a, const double *right, long long b,
                               double *terms, Lanes *out);

/* Fold signals (columns, count) about the middle of the window: sums and differences (2, columns,
   half) of opposite samples. Even modes depend on sums only, odd ones on differences. */
PRIVATE void fold(const Models *m, double *const *signals, long long columns, double *folded);

/* Compute the coefficients (columns, rows) of folded signals in the modes from `begin` to `end`. */
PRIVATE void project(const Models *m, const double *folded, long long columns, long long begin,
                     long long end, double *coefficients);

#endif
