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

#define LANES 8
#define VECTORS (LANES / WIDTH)
/* The noise prior, in samples: a window has less information on its noise than the measurement. */
#define NOISE_PRIOR_SAMPLES 300.0
/* Models with a smaller weight in the covariance, or a smaller probability, are skipped: the result
   changes by less than this. */
#define MIN_WEIGHT 1e-5
#define MIN_PROBABILITY 1e-8
/* Models this far below the best in log evidence are skipped: exp(-25) is below both. */
#define MAX_EVIDENCE_LOSS 50.0
/* Loss of log evidence after which shorter lengths of a spectrum are skipped in sets with events:
   their evidence is lower still. */
#define LENGTH_EVIDENCE_LOSS 8.0
/* Derivatives by which samples are moved: as many as `slopes_of` of _models.py makes. */
#define SLOPE_ORDERS 4
/* Bound of the number of spectra, of which _models.py has four. */
#define MAX_SPECTRA 8
/* Largest weight of the rough spectrum in the covariance, over that of another spectrum. With 1,
   88% of the cells cover over 97%. */
#define MAX_ROUGH_WEIGHT 0.1
/* Sets of events: none, one of each order, and two. Columns of two events. */
#define MAX_SETS 6
#define MAX_STEPS 6
/* Derivatives of order 0 to 4. */
#define MAX_ORDERS 5

/* As wide as the vectors of the processor: compilers break up wider ones badly. */
typedef double Vector __attribute__((vector_size(8 * WIDTH), aligned(8)));
typedef struct {
    Vector part[VECTORS];
} Lanes;

#define FOR_VECTORS for (int h = 0; h < VECTORS; h++)

static inline Lanes
all_lanes(double value)
{
    Lanes all;
    FOR_VECTORS all.part[h] = (Vector){0} + value;
    return all;
}

static inline Lanes
scaled(Lanes a, double by)
{
    FOR_VECTORS a.part[h] *= by;
    return a;
}

static inline Lanes
product(Lanes a, Lanes b)
{
    FOR_VECTORS a.part[h] *= b.part[h];
    return a;
}

static inline Lanes
multiply_add(Lanes sum, Lanes a, Lanes b)
{
    FOR_VECTORS sum.part[h] += a.part[h] * b.part[h];
    return sum;
}

static inline Lanes
multiply_subtract(Lanes sum, Lanes a, Lanes b)
{
    FOR_VECTORS sum.part[h] -= a.part[h] * b.part[h];
    return sum;
}

static inline double
larger(double a, double b)
{
    return a > b ? a : b;
}

static inline double
smaller(double a, double b)
{
    return a < b ? a : b;
}

static inline double
sum_of(Lanes lanes)
{
    double sum = 0.0;
    for (int i = 0; i < LANES; i++)
        sum += ((double *)&lanes)[i];
    return sum;
}

static inline double
dot(const double *a, const double *b, long long count)
{
    double sum = 0.0;
    for (long long k = 0; k < count; k++)
        sum += a[k] * b[k];
    return sum;
}

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

/* A step of the derivative of an `order` from 0 to 3, `place` samples after the first sample. */
typedef struct {
    double place;
    int order;
} Step;

/* The derivatives at an instant, as `stencils_of` of _models.py makes them. */
typedef struct {
    long long orders;
    double at;           /* the instant, samples after the first */
    const double *modes; /* (orders, rows): derivatives of the modes */
    const Lanes *spread; /* (groups, orders, orders): covariances for unit noise */
} Stencils;

/* The samples of a signal, `count` of angle and both coordinates, in deviations of their noise;
   their weights, 0 to 1, by angle and position; and by how many samples each is after its place. */
typedef struct {
    long long count;
    double *x[3], *weight[2], *off;
} Samples;

/* The result at an instant: derivatives, their covariances, of the angle and of one coordinate, and
   the effective number of parameters of the motion. */
typedef struct {
    double mean[3][MAX_ORDERS], covariance[2][MAX_ORDERS][MAX_ORDERS], freedom[2];
} Estimate;

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

/* Models with columns: first `cells`, samples with a weight below 1, then `steps` of events. The
   size of a column has a prior of zero mean and variance root^2 / weight. That of a step is the
   estimated size squared, with a weight of 1. That of a sample of weight w is (1 - w) / w, so its
   noise has the variance 1 / w. Weights and roots are by angle and position, (parts, columns), with
   one part if these are equal. */
typedef struct {
    long long columns, cells, steps, parts, events;
    long long *cell;       /* (cells): the samples */
    Step step[MAX_STEPS];
    double log_prior;      /* of the events */
    double best_evidence[2];
    double place_covariance[2][MAX_ORDERS][MAX_ORDERS]; /* from the unknown places of the events */
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

static size_t
size_of_set(const Models *m, long long orders, long long columns, long long steps, int parts)
{
    long long pairs = columns * (columns + 1) / 2;
    long long of_lanes = m->groups * (8 + 3 * orders + parts * pairs + 3 * columns);
    long long of_numbers = steps * (m->count + 2 * m->half) + columns * (m->rows + 8) + pairs +
                           m->groups;
    return 8 * (of_lanes * LANES + of_numbers);
}

#define TAKE(array, size) (array = (void *)data, data += (size) * sizeof *array)

/* Lay out the arrays of a set, and return the end of their memory. */
static char *
lay_out_set(const Models *m, long long orders, long long columns, long long steps, int parts,
            char *data, Set *set)
{
    long long pairs = columns * (columns + 1) / 2;
    *set = (Set){.columns = columns, .parts = parts};
    TAKE(set->evidence, 2 * m->groups), TAKE(set->variance, 2 * m->groups);
    TAKE(set->probability, 2 * m->groups), TAKE(set->covariance_weight, 2 * m->groups);
    TAKE(set->derivatives, 3 * orders * m->groups), TAKE(set->factors, parts * pairs * m->groups);
    TAKE(set->residuals, 3 * columns * m->groups);
    TAKE(set->step_columns, steps * m->count), TAKE(set->folded, steps * 2 * m->half);
    TAKE(set->coefficients, columns * m->rows);
    TAKE(set->column_products, pairs + 3 * columns), TAKE(set->weight, 2 * columns);
    TAKE(set->root, 2 * columns), TAKE(set->cell, columns), TAKE(set->is_used, m->groups);
    return data;
}

/* Add to out[c] the sum over k < depth of table[k] values[c][k], for each of the columns c. Rows of
   `values` are `stride` apart, and elements of `out` are `step` apart. Three columns are summed at
   once, so that the processor need not wait for each sum. */
static inline void
add_table_products(const Lanes *table, long long depth, const double *values, long long stride,
                   long long columns, Lanes *out, long long step)
{
    for (; columns >= 3; columns -= 3, values += 3 * stride, out += 3 * step) {
        Lanes x = out[0], y = out[step], z = out[2 * step];
        for (long long k = 0; k < depth; k++) {
            FOR_VECTORS x.part[h] += table[k].part[h] * values[k];
            FOR_VECTORS y.part[h] += table[k].part[h] * values[stride + k];
            FOR_VECTORS z.part[h] += table[k].part[h] * values[2 * stride + k];
        }
        out[0] = x, out[step] = y, out[2 * step] = z;
    }
    for (; columns > 0; columns--, values += stride, out += step) {
        Lanes x = out[0];
        for (long long k = 0; k < depth; k++)
            FOR_VECTORS x.part[h] += table[k].part[h] * values[k];
        out[0] = x;
    }
}

/* Add to `out` (a, b) the sums over the modes r of a group's process of table[r] left[i][r]
   right[j][r], for left (a, rows) and right (b, rows). Without `right` these are the pairs j <= i
   of left. */
static inline void
add_mode_products(const Models *m, const Lanes *table, long long group, const double *left,
                  long long a, const double *right, long long b, double *terms, Lanes *out)
{
    const long long *first = m->first_row + group / m->chunks;
    table += group % m->chunks * m->rows;
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        long long begin = first[0], depth = first[1] - begin, columns = 0;
        for (long long i = 0; i < a; i++)
            for (long long j = 0; j < (right ? b : i + 1); j++, columns++) {
                const double *x = left + i * m->rows + begin;
                const double *y = (right ? right : left) + j * m->rows + begin;
                for (long long k = 0; k < depth; k++)
                    terms[columns * depth + k] = x[k] * y[k];
            }
        add_table_products(table + begin, depth, terms, depth, columns, out, 1);
    }
}

/* Fold signals (columns, count) about the middle of the window: sums and differences (2, columns,
   half) of opposite samples. Even modes depend on sums only, odd ones on differences. */
static inline void
fold(const Models *m, double *const *signals, long long columns, double *folded)
{
    long long n = m->count, half = m->half;
    for (long long c = 0; c < columns; c++)
        for (long long t = 0; t < half; t++) {
            double a = signals[c][t], b = signals[c][n - 1 - t];
            folded[c * half + t] = a + b, folded[(columns + c) * half + t] = a - b;
        }
}

/* Compute the coefficients (columns, rows) of folded signals in the modes from `begin` to `end`. */
static inline void
project(const Models *m, const double *folded, long long columns, long long begin, long long end,
        double *coefficients)
{
    for (long long r = begin / LANES * LANES; r < end; r += LANES) {
        for (long long c = 0; c < columns; c++)
            memset(coefficients + c * m->rows + r, 0, LANES * sizeof(double));
        add_table_products(m->basis + r / LANES * m->half, m->half,
                           folded + (r < m->first_odd ? 0 : columns * m->half), m->half, columns,
                           (Lanes *)(coefficients + r), m->rows / LANES);
    }
}

/* Compute the coefficients of samples, and the residual sum of squares of each model. */
static void
project_samples(const Models *m, const Samples *s, Work *w)
{
    for (int c = 0; c < 3; c++) {
        w->sum_of_squares[c] = 0.0;
        for (long long t = 0; t < m->count; t++)
            w->sum_of_squares[c] += s->x[c][t] * s->x[c][t];
    }
    fold(m, s->x, 3, w->terms);
    project(m, w->terms, 3, 0, m->rows, w->coefficients);
    for (long long i = 0; i < 3 * m->rows; i++)
        w->squares[i] = w->coefficients[i] * w->coefficients[i];
    memset(w->residual, 0, 3 * m->groups * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const long long *first = m->first_row + g / m->chunks;
        for (int parity = 0; parity < 2; parity++, first += m->processes + 1)
            add_table_products(m->residual_factor + g % m->chunks * m->rows + first[0],
                               first[1] - first[0], w->squares + first[0], m->rows, 3,
                               w->residual + g, m->groups);
        for (int c = 0; c < (m->exact ? 0 : 3); c++)
            FOR_VECTORS w->residual[c * m->groups + g].part[h] =
                w->sum_of_squares[c] - w->residual[c * m->groups + g].part[h];
    }
}

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

/* Compute the column (count) of a step, for samples that are means of blocks. */
static void
fill_step_column(const Step *step, long long count, long long block, double *column)
{
    for (long long t = 0; t < count; t++) {
        column[t] = 0.0;
        for (long long k = 0; k < block; k++) {
            double offset = (k - (block - 1) / 2.0) / block;
            column[t] += step_value(step->order, t + offset - step->place) / block;
        }
    }
}

/* Copy the coefficients of cells, which are unit vectors, from the basis. */
static void
project_cells(const Models *m, Set *set)
{
    for (long long x = 0; x < set->cells; x++) {
        long long at = set->cell[x], opposite = m->count - 1 - at;
        long long near = at < opposite ? at : opposite;
        double even = at == opposite ? 2.0 : 1.0, odd = at > opposite ? -1.0 : 1.0;
        for (long long r = 0; r < m->rows; r++)
            set->coefficients[x * m->rows + r] = (r < m->first_odd ? even : odd) *
                ((const double *)(m->basis + r / LANES * m->half + near))[r % LANES];
    }
}

/* Compute the coefficients of the steps of a set in the modes of one process. */
static void
project_steps(const Models *m, long long process, Set *set)
{
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first_row + parity * (m->processes + 1) + process;
        project(m, set->folded, set->steps, first[0], first[1],
                set->coefficients + set->cells * m->rows);
    }
}

/* Compute the products of columns with each other, (pairs), and with samples, (3, columns). */
static void
find_column_products(const Models *m, const Samples *s, Set *set)
{
    long long number = set->columns, cells = set->cells, n = m->count;
    double *out = set->column_products;
    for (long long i = 0; i < number + 3; i++)
        for (long long j = 0; j < (i < number ? i + 1 : number); j++) {
            if (i < cells) {
                *out++ = i == j;
                continue;
            }
            const double *row = i < number ? set->step_columns + (i - cells) * n : s->x[i - number];
            *out++ = j < cells ? row[set->cell[j]]
                               : dot(row, set->step_columns + (j - cells) * n, n);
        }
}

/* Solve L y = root values in place, with L D L' of `factorize`; `over_pivots` is y / D. */
static inline void
forward_substitute(const Lanes *factor, const double *root, long long number, Lanes *values,
                   Lanes *over_pivots)
{
    for (long long x = 0; x < number; x++) {
        Lanes sum = scaled(values[x], root[x]);
        for (long long k = 0; k < x; k++)
            sum = multiply_subtract(sum, *factor++, values[k]);
        values[x] = sum;
        over_pivots[x] = product(sum, *factor++);
    }
}

/* Factorize diag(weight) + diag(root) C diag(root) = L D L', for the products C (pairs) of columns;
   `factor` (pairs) is L, with 1 / D on its diagonal. Returns half of the log determinant. */
static inline Lanes
factorize(const Lanes *products, const double *weight, const double *root, long long number,
          Lanes *factor)
{
    Lanes logs = all_lanes(0.0), determinant = all_lanes(1.0);
    for (long long i = 0; i < number; i++) {
        const Lanes *covariance = products + i * (i + 1) / 2;
        Lanes *row = factor + i * (i + 1) / 2, diagonal = scaled(covariance[i], root[i] * root[i]);
        for (long long j = 0; j < i; j++) {
            const Lanes *other = factor + j * (j + 1) / 2;
            Lanes sum = scaled(covariance[j], root[i] * root[j]);
            for (long long k = 0; k < j; k++)
                sum = multiply_subtract(sum, row[k], other[k]);
            row[j] = sum;
        }
        FOR_VECTORS diagonal.part[h] += weight[i];
        /* Until now the row is L times D. */
        for (long long k = 0; k < i; k++) {
            Lanes before = row[k];
            row[k] = product(row[k], factor[k * (k + 3) / 2]);
            diagonal = multiply_subtract(diagonal, before, row[k]);
        }
        determinant = product(determinant, diagonal);
        FOR_VECTORS row[i].part[h] = 1.0 / diagonal.part[h];
        /* One logarithm for 8 columns: few calls, and no underflow of the product. */
        if (i % 8 == 7 || i == number - 1) {
            for (int l = 0; l < LANES; l++)
                ((double *)&logs)[l] += log(((double *)&determinant)[l]) / 2;
            determinant = all_lanes(1.0);
        }
    }
    return logs;
}

/* Compute by how much the columns reduce the residual sums of squares of a group's models, and half
   of what they add to the log determinant (matrix inversion lemma: Rasmussen and Williams, A.3). */
static inline void
apply_columns(const Models *m, long long group, const Work *w, const Set *set, Lanes *reduction,
              Lanes *logs)
{
    long long number = set->columns, pairs = number * (number + 1) / 2, all = pairs + 3 * number;
    /* b' P b of columns and b' P x of samples, with the inverse P of the model's covariance. */
    Lanes *products = w->column_products;
    memset(products, 0, all * sizeof(Lanes));
    add_mode_products(m, m->residual_factor, group, set->coefficients, number, NULL, 0, w->terms,
                      products);
    add_mode_products(m, m->residual_factor, group, w->coefficients, 3, set->coefficients, number,
                      w->terms, products + pairs);
    for (long long k = 0; k < (m->exact ? 0 : all); k++)
        FOR_VECTORS products[k].part[h] = set->column_products[k] - products[k].part[h];
    for (long long part = 0; part < set->parts; part++)
        logs[part] = factorize(products, set->weight + part * number, set->root + part * number,
                               number, set->factors + (group * set->parts + part) * pairs);
    if (set->parts == 1)
        logs[1] = logs[0];
    for (int c = 0; c < 3; c++) {
        long long part = set->parts > 1 && c > 0;
        Lanes *residual = set->residuals + (group * 3 + c) * number;
        memcpy(residual, products + pairs + c * number, number * sizeof(Lanes));
        forward_substitute(set->factors + (group * set->parts + part) * pairs,
                           set->root + part * number, number, residual, w->over_pivots);
        for (long long x = 0; x < number; x++)
            reduction[c] = multiply_add(reduction[c], residual[x], w->over_pivots[x]);
    }
}

/* Compute the variance of the noise and the log evidence of a group's models, from their residual
   sums of squares (2) and half log determinants of columns (2). Returns the best evidence. */
static inline double
evaluate_group(const Models *m, const Work *w, long long group, int c, const Lanes *residual,
               const Lanes *logs, Set *set)
{
    double number = w->prior_samples + w->total_weight[c] * (c + 1), best = -INFINITY;
    double *evidence = (double *)(set->evidence + c * m->groups + group);
    double *variance = (double *)(set->variance + c * m->groups + group);
    for (int i = 0; i < LANES; i++) {
        variance[i] = (((double *)(residual + c))[i] + w->prior_samples) / number;
        evidence[i] = ((const double *)(m->log_prior + c * m->groups + group))[i] -
            number / 2 * log(variance[i]) - ((double *)(logs + c))[i] * (c + 1) + set->log_prior;
        best = larger(best, evidence[i]);
    }
    return best;
}

/* Compute the evidence of all models with the columns of a set, and the variance of their noise,
   after `project_samples`. With steps, the rough spectrum is left out, and so are lengths shorter
   than one whose evidence is far below that of a longer one: theirs is lower still. */
static void
evaluate_models(const Models *m, const Samples *s, const Work *w, Set *set)
{
    double top[2] = {-INFINITY, -INFINITY};
    int dropped = 0;
    if (set->columns)
        find_column_products(m, s, set);
    set->best_evidence[0] = set->best_evidence[1] = -INFINITY;
    for (long long g = 0; g < m->groups; g++) {
        Lanes residual[3], reduction[3], logs[2];
        int rough = m->spectrum[g * LANES] == m->spectra - 1, lower = 1;
        if (set->steps) {
            if (g && m->spectrum[g * LANES] != m->spectrum[(g - 1) * LANES])
                top[0] = top[1] = -INFINITY, dropped = 0;
            if (dropped || rough) {
                set->evidence[g] = set->evidence[m->groups + g] = all_lanes(-INFINITY);
                set->variance[g] = set->variance[m->groups + g] = all_lanes(1.0);
                continue;
            }
            project_steps(m, g, set);
        }
        memset(reduction, 0, sizeof reduction), memset(logs, 0, sizeof logs);
        if (set->columns)
            apply_columns(m, g, w, set, reduction, logs);
        for (int c = 0; c < 3; c++) {
            FOR_VECTORS residual[c].part[h] =
                w->residual[c * m->groups + g].part[h] - reduction[c].part[h];
            for (int i = 0; i < LANES; i++)
                if (((double *)(residual + c))[i] < 0.0)
                    ((double *)(residual + c))[i] = 0.0;
        }
        FOR_VECTORS residual[1].part[h] += residual[2].part[h];
        for (int c = 0; c < 2; c++) {
            double best = evaluate_group(m, w, g, c, residual, logs, set);
            if (!rough)
                set->best_evidence[c] = larger(set->best_evidence[c], best);
            lower &= best < top[c] - LENGTH_EVIDENCE_LOSS;
            top[c] = larger(top[c], best);
        }
        dropped = lower && m->spectrum[g * LANES] < m->spectra;
    }
}

/* Compute the probabilities of all models with all sets, from their evidence. */
static void
find_probabilities(const Models *m, int c, Set *sets, int number)
{
    long long models = m->groups * LANES;
    double best = -INFINITY, sum = 0.0;
    for (int n = 0; n < number; n++)
        best = larger(best, sets[n].best_evidence[c]);
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        double *probability = (double *)(sets[n].probability + c * m->groups);
        for (long long i = 0; i < models; i++) {
            int is_rough = m->spectrum[i] == m->spectra - 1;
            int is_skipped = is_rough || evidence[i] < best - MAX_EVIDENCE_LOSS;
            probability[i] = is_skipped ? 0.0 : exp(evidence[i] - best);
            /* A comparison with NaN is false, so NaN reaches the result. */
            if (probability[i] < MIN_PROBABILITY)
                probability[i] = 0.0;
            sum += probability[i];
        }
    }
    for (int n = 0; n < number; n++)
        for (long long i = 0; i < models; i++)
            ((double *)(sets[n].probability + c * m->groups))[i] /= sum;
}

/* Compute the weights of all models with all sets in the covariance: square roots of the evidence,
   with half of the log prior of events. All spectra have the same total, each with the models that
   are common to all, because samples contain no information on harmonics below the noise. The
   total of the rough spectrum, the last, is MAX_ROUGH_WEIGHT of theirs, times the root of its sum
   over theirs. */
static void
find_covariance_weights(const Models *m, int c, Set *sets, int number)
{
    long long models = m->groups * LANES, common = m->spectra, rough = common - 1;
    double top[MAX_SPECTRA + 1], total[MAX_SPECTRA + 1] = {0}, smooth_top = -INFINITY;
    for (long long k = 0; k <= common; k++)
        top[k] = -INFINITY;
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        for (long long i = 0; i < models; i++)
            top[m->spectrum[i]] =
                larger(top[m->spectrum[i]], evidence[i] - sets[n].log_prior / 2);
    }
    for (long long k = 0; k <= common; k++)
        smooth_top = k == rough ? smooth_top : larger(smooth_top, top[k]);
    /* A common model is skipped only if it is far below the best of every spectrum. */
    double lowest = top[common];
    for (long long k = 0; k < rough; k++) {
        top[k] = larger(top[k], top[common]);
        lowest = k ? smaller(lowest, top[k]) : top[k];
    }
    top[common] = lowest;
    double highest = larger(smooth_top, top[rough]);
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++) {
            double value = evidence[i] - sets[n].log_prior / 2;
            long long k = m->spectrum[i];
            weight[i] = value < top[k] - MAX_EVIDENCE_LOSS
                ? 0.0 : exp((value - (k == rough ? highest : smooth_top)) / 2);
            total[k] += weight[i];
        }
    }
    double of_common = 0.0, sum = 0.0, largest = 0.0;
    for (long long k = 0; k < rough; k++) {
        total[k] += total[common];
        largest = larger(largest, total[k]);
        total[k] = total[k] > 1e-300 ? 1.0 / total[k] : 0.0;
        of_common += total[k];
    }
    total[common] = of_common;
    double ratio = smaller(total[rough] / largest * exp((highest - smooth_top) / 2), 1.0);
    total[rough] = total[rough] > 1e-300 ? MAX_ROUGH_WEIGHT * sqrt(ratio) / total[rough] : 0.0;
    for (int n = 0; n < number; n++) {
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++)
            sum += weight[i] *= total[m->spectrum[i]];
    }
    for (int n = 0; n < number; n++) {
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++) {
            weight[i] /= sum;
            if (weight[i] < MIN_WEIGHT)
                weight[i] = 0.0;
        }
    }
}

/* Sums over models: derivatives (3, orders), covariances (2, orders, orders), and parameters. */
typedef struct {
    Lanes mean[3 * MAX_ORDERS], spread[2 * MAX_ORDERS * MAX_ORDERS], freedom[2];
} Sums;

/* Correct the derivatives (3, orders) of a group and their covariances for the columns. The effect
   of a column of size 1 on the derivatives, by which its estimated size is subtracted, is what the
   model makes of the column, less the derivatives of the step itself at the instant. `variance` is
   that of the noise times the weight in the covariance. */
static inline void
correct_for_columns(const Models *m, const Stencils *s, long long group, const Work *w,
                    const Set *set, const Lanes *variance, Lanes *derivatives, Lanes *spread)
{
    long long orders = s->orders, number = set->columns, pairs = number * (number + 1) / 2;
    Lanes *effects = w->column_effects + orders * number;
    memset(effects, 0, orders * number * sizeof(Lanes));
    add_mode_products(m, m->shrinkage, group, s->modes, orders, set->coefficients, number, w->terms,
                      effects);
    for (long long k = 0; k < orders; k++)
        for (long long x = set->cells; x < number; x++) {
            const Step *step = set->step + x - set->cells;
            if (k <= step->order)
                FOR_VECTORS effects[k * number + x].part[h] -=
                    step_value(step->order - k, s->at - step->place);
        }
    for (long long part = 0; part < set->parts; part++) {
        memcpy(w->column_effects, effects, orders * number * sizeof(Lanes));
        for (long long k = 0; k < orders; k++) {
            Lanes *effect = w->column_effects + k * number, *over = w->over_pivots + k * number;
            forward_substitute(set->factors + (group * set->parts + part) * pairs,
                               set->root + part * number, number, effect, over);
            for (int c = 0; c < 3; c++)
                for (long long x = 0; x < number && (set->parts == 1 || part == (c > 0)); x++)
                    derivatives[c * orders + k] =
                        multiply_subtract(derivatives[c * orders + k], over[x],
                                          set->residuals[(group * 3 + c) * number + x]);
            for (long long j = 0; j <= k; j++) {
                Lanes covariance = all_lanes(0.0);
                for (long long x = 0; x < number; x++)
                    covariance =
                        multiply_add(covariance, effect[x], w->over_pivots[j * number + x]);
                for (int c = 0; c < 2; c++)
                    if (set->parts == 1 || part == c) {
                        Lanes *sum = spread + (c * orders + k) * orders + j;
                        *sum = multiply_add(*sum, variance[c], covariance);
                    }
            }
        }
    }
}

/* Multiply the weights of a group in the covariance by the variances of the noise, into `variance`
   (2). Returns whether the group has any weight or probability. */
static inline int
weigh_variances(const Models *m, const Set *set, long long group, Lanes *variance)
{
    double any = 0.0;
    for (int c = 0; c < 2; c++) {
        variance[c] = set->covariance_weight[c * m->groups + group];
        any += sum_of(variance[c]) + sum_of(set->probability[c * m->groups + group]);
        /* The variance of a lane without a model need not be a number. */
        for (int i = 0; i < LANES; i++)
            if (((double *)(variance + c))[i] != 0.0)
                ((double *)(variance + c))[i] *=
                    ((double *)(set->variance + c * m->groups + group))[i];
    }
    return any != 0.0;
}

/* Add the derivatives of a group with all sets to the sums, weighted, and their covariances. */
static inline void
add_group(const Models *m, const Stencils *s, long long group, const Work *w, Set *sets, int number,
          Sums *sums)
{
    long long orders = s->orders, square = orders * orders;
    Lanes without_columns[3 * MAX_ORDERS];
    int is_computed = 0;
    for (int n = 0; n < number; n++) {
        Set *set = sets + n;
        Lanes variance[2], *derivatives = set->derivatives + group * 3 * orders;
        set->is_used[group] = weigh_variances(m, set, group, variance);
        if (!set->is_used[group])
            continue;
        if (!is_computed) {
            memset(without_columns, 0, 3 * orders * sizeof(Lanes));
            add_mode_products(m, m->shrinkage, group, w->coefficients, 3, s->modes, orders,
                              w->terms, without_columns);
        }
        is_computed = 1;
        memcpy(derivatives, without_columns, 3 * orders * sizeof(Lanes));
        for (int c = 0; c < 2; c++) {
            Lanes freedom = m->freedom[group];
            FOR_VECTORS freedom.part[h] += (double)set->events;
            sums->freedom[c] = multiply_add(sums->freedom[c],
                                            set->probability[c * m->groups + group], freedom);
            for (long long k = 0; k < square; k++)
                sums->spread[c * square + k] = multiply_add(
                    sums->spread[c * square + k], variance[c], s->spread[group * square + k]);
        }
        if (set->columns)
            correct_for_columns(m, s, group, w, set, variance, derivatives, sums->spread);
        for (long long k = 0; k < 3 * orders; k++)
            sums->mean[k] = multiply_add(sums->mean[k],
                                         set->probability[(k >= orders) * m->groups + group],
                                         derivatives[k]);
    }
}

/* Add the weighted variance between the models, about the mean, to the covariances. That of the
   position is the mean of both coordinates. */
static inline void
add_disagreement(const Models *m, long long orders, const Set *set, const Estimate *estimate,
                 Lanes *spread)
{
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (set->is_used[g] ? 3 : 0); c++)
            for (long long k = 0; k < orders; k++) {
                Lanes *deviations = set->derivatives + (g * 3 + c) * orders, weighted;
                FOR_VECTORS deviations[k].part[h] -= estimate->mean[c][k];
                weighted = product(set->covariance_weight[(c > 0) * m->groups + g], deviations[k]);
                weighted = scaled(weighted, c ? 0.5 : 1.0);
                for (long long j = 0; j <= k; j++) {
                    Lanes *sum = spread + ((c > 0) * orders + k) * orders + j;
                    *sum = multiply_add(*sum, weighted, deviations[j]);
                }
            }
}

/* Differentiate samples: the mean over all models with all sets by their probabilities, and its
   covariance, the weighted mean of those of the models, plus the variance between the models, plus
   that of the places of the events. */
static void
differentiate(const Models *m, const Stencils *s, const Work *w, Set *sets, int number,
              Estimate *out)
{
    long long orders = s->orders, square = orders * orders;
    Sums sums;
    memset(&sums, 0, sizeof sums);
    for (int c = 0; c < 2; c++)
        find_probabilities(m, c, sets, number), find_covariance_weights(m, c, sets, number);
    for (long long g = 0; g < m->groups; g++)
        add_group(m, s, g, w, sets, number, &sums);
    for (long long k = 0; k < 3 * orders; k++)
        out->mean[k / orders][k % orders] = sum_of(sums.mean[k]);
    for (int n = 0; n < number; n++)
        add_disagreement(m, orders, sets + n, out, sums.spread);
    for (int c = 0; c < 2; c++) {
        out->freedom[c] = sum_of(sums.freedom[c]);
        for (long long k = 0; k < orders; k++)
            for (long long j = 0; j <= k; j++)
                out->covariance[c][k][j] = out->covariance[c][j][k] =
                    sum_of(sums.spread[(c * orders + k) * orders + j]);
        for (int n = 1; n < number; n++) {
            double weight = 0.0;
            for (long long g = 0; g < m->groups; g++)
                weight += sum_of(sets[n].covariance_weight[c * m->groups + g]);
            for (long long k = 0; k < square; k++)
                out->covariance[c][k / orders][k % orders] +=
                    weight * sets[n].place_covariance[c][k / orders][k % orders];
        }
    }
}

/* Add to `error` (cells, 3) by how much samples at the cells exceed their prediction from the other
   samples, in the mean of all models. */
static inline void
add_prediction_errors(const Models *m, const Work *w, const Set *set, double *error)
{
    long long number = set->columns, pairs = number * (number + 1) / 2;
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (set->is_used[g] ? 3 : 0); c++) {
            long long part = set->parts > 1 && c > 0;
            const Lanes *factor = set->factors + (g * set->parts + part) * pairs;
            const Lanes *residual = set->residuals + (g * 3 + c) * number;
            Lanes *size = w->over_pivots;
            /* The sizes of the columns are root times L'^-1 D^-1 residual, by back substitution. */
            for (long long x = number - 1; x >= 0; x--) {
                size[x] = product(residual[x], factor[x * (x + 3) / 2]);
                for (long long k = x + 1; k < number; k++)
                    size[x] = multiply_subtract(size[x], factor[k * (k + 1) / 2 + x], size[k]);
                error[x * 3 + c] += set->root[part * number + x] *
                    sum_of(product(size[x], set->probability[(c > 0) * m->groups + g]));
            }
        }
}

/* Move the samples `given` to the even grid: subtract the Taylor series, up to SLOPE_ORDERS, of the
   motion that is estimated from the samples `placed` in the previous round. `slopes` (SLOPE_ORDERS,
   panels of LANES, rows) are the derivatives of the modes at the first half of the samples. Missing
   samples move to their prediction from the others. */
static void
move_to_grid(const Models *m, const Lanes *slopes, const Samples *given, const Samples *placed,
             Work *w, Set *set, double *const moved[3])
{
    long long rows = m->rows, n = m->count, panels = (m->half + LANES - 1) / LANES;
    project_samples(m, placed, w);
    evaluate_models(m, placed, w, set);
    for (int c = 0; c < 2; c++)
        find_probabilities(m, c, set, 1);
    /* Derivatives (2, SLOPE_ORDERS, 3, panels) of the even and of the odd part of the motion. */
    double *motion = w->squares;
    memset(w->slopes, 0, 2 * SLOPE_ORDERS * 3 * panels * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const Lanes probability[2] = {set->probability[g], set->probability[m->groups + g]};
        set->is_used[g] = sum_of(probability[0]) != 0.0 || sum_of(probability[1]) != 0.0;
        for (int parity = 0; parity < (set->is_used[g] ? 2 : 0); parity++) {
            const long long *first = m->first_row + parity * (m->processes + 1) + g / m->chunks;
            for (long long r = first[0]; r < first[1]; r++) {
                Lanes shrinkage = m->shrinkage[g % m->chunks * rows + r];
                double of_angle = sum_of(product(shrinkage, probability[0]));
                double of_position = sum_of(product(shrinkage, probability[1]));
                for (int c = 0; c < 3; c++)
                    motion[c * rows + r] =
                        (c ? of_position : of_angle) * w->coefficients[c * rows + r];
            }
            Lanes *out = w->slopes + parity * SLOPE_ORDERS * 3 * panels;
            for (long long k = 0; k < SLOPE_ORDERS * panels; k++)
                add_table_products(slopes + k * rows + first[0], first[1] - first[0],
                                   motion + first[0], rows, 3,
                                   out + k / panels * 3 * panels + k % panels, panels);
        }
    }
    for (int c = 0; c < 3; c++)
        for (long long t = 0; t < n; t++) {
            long long near = t < m->half ? t : n - 1 - t;
            double power = 1.0, sum = 0.0;
            for (int k = 0; k < SLOPE_ORDERS; k++) {
                double even = ((double *)(w->slopes + (k * 3 + c) * panels))[near];
                double odd = ((double *)(w->slopes + ((SLOPE_ORDERS + k) * 3 + c) * panels))[near];
                /* The first and the third derivative of an even function are odd. */
                power *= given->off[t] / (k + 1);
                sum += power * (t == near ? even + odd : k % 2 ? even - odd : odd - even);
            }
            moved[c][t] = given->x[c][t] - sum;
        }
    double *error = w->terms;
    memset(error, 0, 3 * set->cells * sizeof(double));
    add_prediction_errors(m, w, set, error);
    for (long long x = 0; x < set->cells; x++)
        for (int c = 0; c < 3; c++)
            if (set->weight[x] <= 0.0 && set->weight[(set->parts - 1) * set->cells + x] <= 0.0)
                moved[c][set->cell[x]] = placed->x[c][set->cell[x]] - error[3 * x + c];
}
