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

/* Derivatives from order 0 on, at most. */
#define MAX_ORDERS (HIGHEST + 1)
/* Sets at most: without event, and with the likeliest. Columns of an event at most. */
#define MAX_SETS 2
#define EVENT_COLUMNS 3
/* Groups with the spectrum of the body at most: one of the angle, and one of the position. */
#define MAX_BODY_GROUPS 2
/* Log evidence that an event costs: of the number of its places, and because events are rare. */
#define EVENT_COST 12.0
/* Power of the evidence by which other places of an event count in the covariance. A step may be a
   ramp, which no model of steps has. With 1/2, 10.5% of the cells cover less than 85%; with 1/4,
   8.7%. */
#define PLACE_POWER 0.25

/* The models of a window of `count` samples, as `models_of` of _models.py makes them. A group is
   LANES models of one process, by their amplitudes. A process has one of the `spectra`, with a
   length, or is a low polynomial. A row is a mode of a process, even or odd about the middle of the
   window. */
typedef struct {
    long long count, half; /* samples, and those of the first half, with the middle */
    long long processes;   /* the last is rest */
    long long chunks;      /* groups of each process */
    long long groups;      /* processes times chunks; those of a process follow each other */
    long long spectra;     /* number of spectra; that of the body is the last */
    long long body_begin, body_end; /* groups with the spectrum of the body; equal without one */
    long long exact;       /* each process has as many modes as there are samples */
    long long rows;        /* even modes of all processes, filled to whole lanes, then odd ones */
    long long first_odd;   /* the first row of an odd mode */
    const long long *first_row; /* (2, processes + 1), of the even and the odd modes of a process */
    const long long *spectrum;  /* of each model (groups, LANES); `spectra` if common to all */
    const Lanes *basis;         /* (rows / LANES, half): modes on the first half of the samples */
    const Lanes *shrinkage;     /* (chunks, rows): of each mode, by amplitude */
    const Lanes *residual_factor; /* (chunks, rows): 1 - shrinkage if exact, where a difference
                                     would be rounding; otherwise the shrinkage */
    const Lanes *log_prior;     /* (2, groups), plus (c + 1) sum of log(1 - shrinkage) / 2 */
    const Lanes *parameters;    /* (groups): sum of the shrinkage, the effective parameters */
    const double *step_squares; /* (models, STEP_ORDERS, count), if not exact: b' P b, of a step b
                                   half a sample before each sample, and the inverse P of a model's
                                   covariance */
    const double *of_rest; /* (2): what the spectrum of the body adds to the log prior of rest */
} Models;

/* The derivatives at an instant, as `stencils_of` of _models.py makes them. */
typedef struct {
    long long orders;
    double at;           /* the instant, samples after the first */
    const double *modes; /* (orders, rows): derivatives of the modes */
    const Lanes *covariance; /* (groups, orders, orders): of the derivatives, for unit noise */
} Stencils;

/* Add to out[c] the sum over k < depth of table[k] values[c][k], for each of the `columns` c. Rows
   of `values` are `stride` doubles apart, and elements of `out` are `step` Lanes apart. Three
   columns are summed at once, so that the processor need not wait for each sum. */
PRIVATE void add_table_products(const Lanes *table, long long depth, const double *values,
                                long long stride, long long columns, Lanes *out, long long step);

/* Coefficients in the modes, (count, rows), of `count` signals. */
typedef struct {
    const double *values;
    long long count;
} Columns;

/* Add to `out` (left.count, right.count) the sums over the modes r of a group's process of table[r]
   left[i][r] right[j][r]. `table` (chunks, rows) is one of `m`. Without columns on the right, `out`
   (pairs) has the pairs j <= i of left instead. `terms` is scratch memory for the doubles of as
   many columns as `out` has elements, of a mode each. */
PRIVATE void add_mode_products(const Models *m, const Lanes *table, long long group, Columns left,
                               Columns right, double *terms, Lanes *out);

/* Fold `signals` (columns, count) about the middle of the window. Writes `folded` (2, columns,
   half): sums and differences of opposite samples. Even modes depend on sums only, odd ones on
   differences. */
PRIVATE void fold(const Models *m, double *const *signals, long long columns, double *folded);

/* Compute the `coefficients` (columns, rows) of folded signals in the modes from row `begin` to
   before `end`, and in the others of the same lanes. */
PRIVATE void project(const Models *m, const double *folded, long long columns, long long begin,
                     long long end, double *coefficients);

/* An instant at which a derivative steps. */
typedef struct {
    double place; /* samples after the first sample */
    int order;    /* of the derivative, 0 to 2 */
} Step;

/* Quantities of the samples of a window that do not depend on events, and scratch memory. */
typedef struct {
    double prior_samples;     /* of the prior of the noise, which has unit variance */
    double total_weight[2];   /* sum of the weights */
    double sum_of_squares[3]; /* of the samples */
    double *coefficients; /* (3, rows), of the samples in the modes */
    double *squares;      /* (3, rows), of the coefficients */
    Lanes *residual;      /* (3, groups): residual sum of squares of each model */
    double *terms;        /* scratch of sums over modes, and of folded signals */
    Lanes *column_products; /* scratch (pairs + 3 columns + half): see `apply_columns` */
    Lanes *column_effects;  /* scratch (2, orders, columns): see `correct_for_columns` */
    Lanes *over_pivots;     /* scratch (orders + 1, columns), of `forward_substitute` */
    Lanes *slopes;          /* scratch (2, SLOPE_ORDERS, 3, half / LANES), of `move_to_grid` */
} Work;

/* Models with columns: first `low_samples`, samples with a weight below 1, then `steps` of an
   event. The size of a column has a prior of zero mean and variance root^2 / weight. That of a step
   is the estimated size squared, with a weight of 1. That of a sample of weight w is (1 - w) / w,
   so its noise has the variance 1 / w. Weights and roots are by angle and position, (parts,
   columns), with one part if these are equal. */
typedef struct {
    long long columns, low_samples, steps, parts;
    long long *low_sample;    /* (low_samples): their numbers in the window */
    Step step[EVENT_COLUMNS]; /* (steps) */
    double log_prior;         /* of the event; 0 without one */
    double best_evidence[2];  /* the largest log evidence of a model in `evidence` */
    Lanes of_body[2][MAX_BODY_GROUPS]; /* the log evidence of models that wait for `add_body` */
    double place_covariance[2][MAX_ORDERS][MAX_ORDERS]; /* from the unknown place of the event */
    double *step_columns;  /* (steps, count) */
    double *folded;        /* (2, steps, half): sums and differences of these, see `fold` */
    double *coefficients;  /* (columns, rows), of the columns in the modes */
    double *column_products; /* (pairs + 3 columns), of columns, and of samples with columns */
    double *weight, *root; /* (parts, columns) */
    Lanes *evidence;       /* (2, groups): log evidence of each model; -infinity for none */
    Lanes *variance;       /* (2, groups): estimated variance of the noise at a weight of 1 */
    Lanes *probability;    /* (2, groups): of each model, in the mean; they add up to 1 */
    Lanes *covariance_weight; /* (2, groups): of each model, in the covariance; the same */
    Lanes *derivatives;    /* (groups, 3, orders): at the instant */
    Lanes *factors;        /* (groups, parts, pairs): L and 1 / D, see `factorize` */
    Lanes *residuals;      /* (groups, 3, columns): of the samples at the columns, divided by L */
    long long *is_used;    /* (groups): whether any model has a probability or a weight */
} Set;

/* The signal t^order / order! of a step, t = `since` samples after it; 0 before it. */
static inline double
step_value(int order, double since)
{
    static const double factorial[] = {1.0, 1.0, 2.0};
    double power = since > 0.0 ? 1.0 / factorial[order] : 0.0;
    for (int k = 0; k < order; k++)
        power *= since;
    return power;
}

/* Return the bytes of a set for so many `orders` and `columns`, of which `steps` are steps; `parts`
   is 2 if weights of angle and position differ, else 1. */
PRIVATE size_t size_of_set(const Models *m, long long orders, long long columns, long long steps,
                           int parts);

/* Lay out the arrays of such a set at `data`, with `columns` and `parts`; other values are zero,
   and arrays are not changed. Returns the end of their memory. */
PRIVATE char * lay_out_set(const Models *m, long long orders, long long columns, long long steps,
                           int parts, char *data, Set *set);

/* Compute the `column` (count) of a step, for samples that are means of `block` cells. */
PRIVATE void fill_step_column(const Step *step, long long count, long long block, double *column);

/* Write the `coefficients` of the samples of low weight, whose columns are unit vectors, from the
   basis. */
PRIVATE void project_low_samples(const Models *m, Set *set);

/* Compute the `coefficients` of the steps of a set in the modes of one process, from `folded`. */
PRIVATE void project_steps(const Models *m, long long process, Set *set);

/* Compute `column_products` of a set: of columns with each other, the pairs j <= i, and of samples
   with columns (3, columns). */
PRIVATE void find_column_products(const Models *m, const Samples *s, Set *set);

#endif
