/*
 * The models of a window, as _models.py makes them, and sums over their modes.
 *
 * A set has columns, samples of low weight and steps, with which all models are evaluated.
 */

#ifndef KINPOLE_MODELS_H
#define KINPOLE_MODELS_H

#include <stddef.h>

#include "lanes.h"
#include "samples.h"

/* Derivatives from order 0 on. */
#define MAX_ORDERS (HIGHEST + 1)
/* Sets: without event, with the two likeliest, and with the one that segments show. Columns of an
   event. */
#define MAX_SETS 4
#define EVENT_COLUMNS 3

/* The models of a window of `count` samples, as `models_of` of _models.py makes them. */
typedef struct {
    long long count, half; /* samples, and those of the first half, with the middle */
    long long processes;
    long long chunks;  /* groups of each process */
    long long groups;  /* processes times chunks */
    long long spectra;
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

/* Coefficients in the modes, (count, rows). */
typedef struct {
    const double *values;
    long long count;
} Columns;

/* Add to `out`, of so many columns left and right, the sums over the modes r of a group's process
   of table[r] left[i][r] right[j][r]. Without columns on the right these are the pairs j <= i of
   left. */
PRIVATE void add_mode_products(const Models *m, const Lanes *table, long long group, Columns left,
                               Columns right, double *terms, Lanes *out);

/* Fold signals (columns, count) about the middle of the window: sums and differences (2, columns,
   half) of opposite samples. Even modes depend on sums only, odd ones on differences. */
PRIVATE void fold(const Models *m, double *const *signals, long long columns, double *folded);

/* Compute the coefficients (columns, rows) of folded signals in the modes from `begin` to `end`. */
PRIVATE void project(const Models *m, const double *folded, long long columns, long long begin,
                     long long end, double *coefficients);

/* A step of the derivative of an `order` from 0 to 3, `place` samples after the first sample. */
typedef struct {
    double place;
    int order;
} Step;

/* Quantities of the samples of a window that do not depend on events, and scratch memory. */
typedef struct {
    double prior_samples, total_weight[2], sum_of_squares[3];
    double *coefficients; /* (3, rows), of the samples in the modes */
    double *squares;      /* (3, rows), of the coefficients */
    Lanes *residual;      /* (3, groups): residual sum of squares of each model */
    double *terms;        /* scratch of sums over modes, and of folded signals */
    Lanes *column_products; /* scratch (pairs + 3 columns): see `apply_columns` */
    Lanes *column_effects;  /* scratch (2, orders, columns): see `correct_for_columns` */
    Lanes *over_pivots;     /* scratch (orders + 1, columns), of `forward_substitute` */
    Lanes *slopes;          /* scratch (2, SLOPE_ORDERS, 3, half / LANES), of `move_to_grid` */
} Work;

/* Models with columns: first `cells`, samples with a weight below 1, then `steps` of an event. The
   size of a column has a prior of zero mean and variance root^2 / weight. That of a step is the
   estimated size squared, with a weight of 1. That of a sample of weight w is (1 - w) / w, so its
   noise has the variance 1 / w. Weights and roots are by angle and position, (parts, columns), with
   one part if these are equal. */
typedef struct {
    long long columns, cells, steps, parts;
    long long *cell;       /* (cells): the samples */
    Step step[EVENT_COLUMNS];
    double log_prior;      /* of the event */
    double best_evidence[2];
    double place_covariance[2][MAX_ORDERS][MAX_ORDERS]; /* from the unknown place of the event */
    double *step_columns;  /* (steps, count) */
    double *folded;        /* (2, steps, half): sums and differences of these, see `fold` */
    double *coefficients;  /* (columns, rows), of the columns in the modes */
    double *column_products; /* (pairs + 3 columns), of columns, and of samples with columns */
    double *weight, *root;
    Lanes *evidence, *variance, *probability, *covariance_weight; /* (2, groups) */
    Lanes *derivatives;    /* (groups, 3, orders) */
    Lanes *factors;        /* (groups, parts, pairs): L and 1 / D, see `factorize` */
    Lanes *residuals;      /* (groups, 3, columns): of the samples at the columns, divided by L */
    long long *is_used;    /* (groups) */
} Set;

/* The signal t^order / order! of a step, `since` samples after it. */
static inline double
step_value(int order, double since)
{
    static const double factorial[] = {1.0, 1.0, 2.0, 6.0};
    double power = since > 0.0 ? 1.0 / factorial[order] : 0.0;
    for (int k = 0; k < order; k++)
        power *= since;
    return power;
}

/* Return the bytes of a set with so many columns, of which `steps` are steps; `parts` is 2 if
   weights of angle and position differ, else 1. */
PRIVATE size_t size_of_set(const Models *m, long long orders, long long columns, long long steps,
                           int parts);

/* Lay out the arrays of such a set at `data`, and return the end of their memory. */
PRIVATE char * lay_out_set(const Models *m, long long orders, long long columns, long long steps,
                           int parts, char *data, Set *set);

/* Compute the column (count) of a step, for samples that are means of blocks. */
PRIVATE void fill_step_column(const Step *step, long long count, long long block, double *column);

/* Copy the coefficients of cells, which are unit vectors, from the basis. */
PRIVATE void project_cells(const Models *m, Set *set);

/* Compute the coefficients of the steps of a set in the modes of one process. */
PRIVATE void project_steps(const Models *m, long long process, Set *set);

/* Compute the products of columns with each other, (pairs), and with samples, (3, columns). */
PRIVATE void find_column_products(const Models *m, const Samples *s, Set *set);

#endif
