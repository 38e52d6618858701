/*
 * Evidence of all models of a window of even samples, and mean and covariance of derivatives.
 *
 * Events, and samples with less than full weight, are columns: low-rank corrections of the models.
 *
 * LANES amplitudes of one process are a group, side by side in all arrays. A lane without a model
 * has evidence -infinity. Each process has its own modes, even and odd; the first of each are mean
 * and slope. The last process is rest, which has the mean only.
 */

#define LANES 8
#define PARTS (LANES / WIDTH)
/* The prior of the noise, in samples: a window has less information on it than its measurement. */
#define KNOWN 300.0
/* Models with a smaller weight in the covariance, or a smaller probability, are skipped: the result
   changes by less than this. */
#define LEAST_WEIGHT 1e-5
#define LEAST_PROBABLE 1e-8
/* Models this far below the best in log evidence are skipped: exp(-25) is below both. */
#define FAR 50.0
/* Loss of log evidence after which shorter lengths of a spectrum are skipped in sets with events:
   their evidence is lower still. */
#define DROP_EVIDENCE 8.0
/* Derivatives by which samples are moved: as many as `slopes_of` of _models.py makes. */
#define SLOPES 4
/* Spectra at most. */
#define MOST_KINDS 8
/* Largest weight of the rough spectrum in the covariance, over that of another spectrum. With 1,
   88% of the cells cover over 97%. */
#define ROUGH_SHARE 0.1
/* Sets of events: none, one of each order, and two. Columns of two events. */
#define MOST_SETS 6
#define MOST_STEPS 6

/* A compiler breaks up vectors wider than the processor's, and badly, so they are as wide as those.
   */
typedef double Vector __attribute__((vector_size(8 * WIDTH), aligned(8)));
typedef struct {
    Vector part[PARTS];
} Lanes;

#define EACH for (int h = 0; h < PARTS; h++)

static inline Lanes
all_lanes(double value)
{
    Lanes all;
    EACH all.part[h] = (Vector){0} + value;
    return all;
}

static inline Lanes
scaled(Lanes a, double by)
{
    EACH a.part[h] *= by;
    return a;
}

static inline Lanes
product(Lanes a, Lanes b)
{
    EACH a.part[h] *= b.part[h];
    return a;
}

static inline Lanes
plus(Lanes sum, Lanes a, Lanes b)
{
    EACH sum.part[h] += a.part[h] * b.part[h];
    return sum;
}

static inline Lanes
minus(Lanes sum, Lanes a, Lanes b)
{
    EACH sum.part[h] -= a.part[h] * b.part[h];
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

/* Models of a window of `count` samples, as `models_of` of _models.py makes them. Processes have
   `chunks` groups each, and modes `first[p]` to `first[p + 1]` of the even ones, and so on of the
   odd ones, which begin at the row `odd`. If samples are exact, modes are as many as these. */
typedef struct {
    long long count, half, processes, chunks, groups, kinds, exact, odd, rows;
    const long long *first, *kind;
    const Lanes *panels, *share, *left, *chances, *freedom;
    const double *unexplained; /* of steps, (models, 3, count) */
} Models;

/* The derivative of an `order` from 0 to 3 steps so many samples after the first. */
typedef struct {
    double place;
    int order;
} Step;

/* How modes (orders, rows) and models (groups, orders, orders) make derivatives. */
typedef struct {
    long long orders;
    double at; /* the instant, samples after the first */
    const double *modes;
    const Lanes *spread;
} Stencils;

/* Samples of angle and both coordinates, in deviations of their noise, how good those of angle and
   position are over the best, and by how many samples they are off their places. */
typedef struct {
    long long count;
    double *x[3], *weight[2], *off;
} Samples;

/* Results: derivatives (3, orders), covariances (2, orders, orders) of the angle and of one
   coordinate, and the number of parameters of their motions. */
#define MOST_ORDERS 5
typedef struct {
    double mean[3][MOST_ORDERS], covariance[2][MOST_ORDERS][MOST_ORDERS], freedom[2];
} Found;

/* Quantities of a window that do not depend on events: modes, sums of squares, and those that the
   models leave (3, groups). The other arrays are scratch memory. */
typedef struct {
    double known, seen[2], total[3];
    double *modes, *squares, *terms;
    Lanes *left, *off, *reach, *scaled, *along;
} Work;

/* A set of events, and the models with its columns. The columns are the `cells` with weights below
   1, and then the `steps`. `weight` and `root` of a column are by angle and position, which are one
   part if they are equal: of a cell its weight, and the root of what that is below 1; of a step 1,
   and the standard deviation of its prior. `prior` is the log prior of the events, and `spread` the
   covariance that follows from their places. */
typedef struct Set {
    long long cells, steps, columns, parts, events, *at, *is_used;
    const struct Set *from;
    Step step[MOST_STEPS];
    double prior, best[2], spread[2][MOST_ORDERS][MOST_ORDERS];
    double *values, *folded, *vectors, *base, *weight, *root;
    Lanes *evidence, *variance, *probability, *covariance_weight, *derivatives, *factors, *errors;
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

/* Lay out the arrays of a set, and return what comes after these. */
static char *
lay_out_set(const Models *m, long long orders, long long columns, long long steps, int parts,
            char *data, Set *set)
{
    long long pairs = columns * (columns + 1) / 2;
    *set = (Set){.columns = columns, .parts = parts};
    TAKE(set->evidence, 2 * m->groups), TAKE(set->variance, 2 * m->groups);
    TAKE(set->probability, 2 * m->groups), TAKE(set->covariance_weight, 2 * m->groups);
    TAKE(set->derivatives, 3 * orders * m->groups), TAKE(set->factors, parts * pairs * m->groups);
    TAKE(set->errors, 3 * columns * m->groups);
    TAKE(set->values, steps * m->count), TAKE(set->folded, steps * 2 * m->half);
    TAKE(set->vectors, columns * m->rows);
    TAKE(set->base, pairs + 3 * columns), TAKE(set->weight, 2 * columns);
    TAKE(set->root, 2 * columns), TAKE(set->at, columns), TAKE(set->is_used, m->groups);
    return data;
}

/* out (columns, step apart) += values (columns, stride apart) times table (depth), three columns at
   once, so that sums need not wait for each other. */
static inline void
add(const Lanes *table, long long depth, const double *values, long long stride, long long columns,
    Lanes *out, long long step)
{
    for (; columns >= 3; columns -= 3, values += 3 * stride, out += 3 * step) {
        Lanes x = out[0], y = out[step], z = out[2 * step];
        for (long long k = 0; k < depth; k++) {
            EACH x.part[h] += table[k].part[h] * values[k];
            EACH y.part[h] += table[k].part[h] * values[stride + k];
            EACH z.part[h] += table[k].part[h] * values[2 * stride + k];
        }
        out[0] = x, out[step] = y, out[2 * step] = z;
    }
    for (; columns > 0; columns--, values += stride, out += step) {
        Lanes x = out[0];
        for (long long k = 0; k < depth; k++)
            EACH x.part[h] += table[k].part[h] * values[k];
        out[0] = x;
    }
}

/* out += sums of the products of left (a, rows) and right (b, rows), of each row by each, or of
   each two of left if there is no right, over the modes of a group's process. */
static inline void
add_products(const Models *m, const Lanes *table, long long group, const double *left, long long a,
             const double *right, long long b, double *terms, Lanes *out)
{
    const long long *first = m->first + group / m->chunks;
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
        add(table + begin, depth, terms, depth, columns, out, 1);
    }
}

/* Sums and differences (2, columns, half) of the samples of signals opposite to each other. */
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

/* The modes (columns, rows) from `begin` to `end` of folded signals (columns). */
static inline void
find_modes(const Models *m, const double *folded, long long columns, long long begin, long long end,
           double *modes)
{
    for (long long r = begin / LANES * LANES; r < end; r += LANES) {
        for (long long c = 0; c < columns; c++)
            memset(modes + c * m->rows + r, 0, LANES * sizeof(double));
        add(m->panels + r / LANES * m->half, m->half,
            folded + (r < m->odd ? 0 : columns * m->half), m->half, columns, (Lanes *)(modes + r),
            m->rows / LANES);
    }
}

/* Compute the modes of samples, their sums of squares, and those that each model leaves. */
static void
find_squares(const Models *m, const Samples *s, Work *w)
{
    for (int c = 0; c < 3; c++) {
        w->total[c] = 0.0;
        for (long long t = 0; t < m->count; t++)
            w->total[c] += s->x[c][t] * s->x[c][t];
    }
    fold(m, s->x, 3, w->terms);
    find_modes(m, w->terms, 3, 0, m->rows, w->modes);
    for (long long i = 0; i < 3 * m->rows; i++)
        w->squares[i] = w->modes[i] * w->modes[i];
    memset(w->left, 0, 3 * m->groups * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const long long *first = m->first + g / m->chunks;
        for (int parity = 0; parity < 2; parity++, first += m->processes + 1)
            add(m->left + g % m->chunks * m->rows + first[0], first[1] - first[0],
                w->squares + first[0], m->rows, 3, w->left + g, m->groups);
        for (int c = 0; c < (m->exact ? 0 : 3); c++)
            EACH w->left[c * m->groups + g].part[h] =
                w->total[c] - w->left[c * m->groups + g].part[h];
    }
}

static inline double
step_value(int order, double since)
{
    static const double factorial[] = {1.0, 1.0, 2.0, 6.0};
    double power = since > 0.0 ? 1.0 / factorial[order] : 0.0;
    for (int k = 0; k < order; k++)
        power *= since;
    return power;
}

/* What a step adds to samples (count), each the mean of a block. */
static void
find_values(const Step *step, long long count, long long block, double *values)
{
    for (long long t = 0; t < count; t++) {
        values[t] = 0.0;
        for (long long k = 0; k < block; k++) {
            double offset = (k - (block - 1) / 2.0) / block;
            values[t] += step_value(step->order, t + offset - step->place) / block;
        }
    }
}

static inline double
dot(const double *a, const double *b, long long count)
{
    double sum = 0.0;
    for (long long k = 0; k < count; k++)
        sum += a[k] * b[k];
    return sum;
}

/* Compute the modes of cells. */
static void
find_modes_of_cells(const Models *m, Set *set)
{
    for (long long x = 0; x < set->cells; x++) {
        long long at = set->at[x], opposite = m->count - 1 - at;
        long long near = at < opposite ? at : opposite;
        double even = at == opposite ? 2.0 : 1.0, odd = at > opposite ? -1.0 : 1.0;
        for (long long r = 0; r < m->rows; r++)
            set->vectors[x * m->rows + r] = (r < m->odd ? even : odd) *
                ((const double *)(m->panels + r / LANES * m->half + near))[r % LANES];
    }
}

/* Compute the covariance and residuals (pairs + 3 columns) of all columns without any motion. */
static void
find_column_products(const Models *m, const Samples *s, Set *set)
{
    long long number = set->columns, cells = set->cells, n = m->count, k = 0;
    for (long long i = 0; i < number + 3; i++)
        for (long long j = 0; j < (i < number ? i + 1 : number); j++) {
            if (i < cells) {
                set->base[k++] = i == j;
                continue;
            }
            const double *row = i < number ? set->values + (i - cells) * n : s->x[i - number];
            set->base[k++] =
                j < cells ? row[set->at[j]] : dot(row, set->values + (j - cells) * n, n);
        }
}

/* `values` at columns, by the factors L D L' of their covariance: these times the roots are divided
   by L, and `over` are the same over D. */
static inline void
solve(const Lanes *factor, const double *root, long long number, Lanes *values, Lanes *over)
{
    for (long long x = 0; x < number; x++) {
        Lanes sum = scaled(values[x], root[x]);
        for (long long k = 0; k < x; k++)
            sum = minus(sum, *factor++, values[k]);
        values[x] = sum;
        over[x] = product(sum, *factor++);
    }
}

/* L D L' of the covariance of columns, with the inverse of D on the diagonal; returns half of the
   logarithm of its determinant. */
static inline Lanes
factorize(const Lanes *off, const double *weight, const double *root, long long number,
          Lanes *factor)
{
    Lanes logs = all_lanes(0.0), determinant = all_lanes(1.0);
    for (long long i = 0; i < number; i++) {
        const Lanes *covariance = off + i * (i + 1) / 2;
        Lanes *row = factor + i * (i + 1) / 2, diagonal = scaled(covariance[i], root[i] * root[i]);
        for (long long j = 0; j < i; j++) {
            const Lanes *other = factor + j * (j + 1) / 2;
            Lanes sum = scaled(covariance[j], root[i] * root[j]);
            for (long long k = 0; k < j; k++)
                sum = minus(sum, row[k], other[k]);
            row[j] = sum;
        }
        EACH diagonal.part[h] += weight[i];
        /* Until now the row is L times D. */
        for (long long k = 0; k < i; k++) {
            Lanes before = row[k];
            row[k] = product(row[k], factor[k * (k + 3) / 2]);
            diagonal = minus(diagonal, before, row[k]);
        }
        determinant = product(determinant, diagonal);
        EACH row[i].part[h] = 1.0 / diagonal.part[h];
        /* Few logarithms, but no product that vanishes. */
        if (i % 8 == 7 || i == number - 1) {
            for (int l = 0; l < LANES; l++)
                ((double *)&logs)[l] += log(((double *)&determinant)[l]) / 2;
            determinant = all_lanes(1.0);
        }
    }
    return logs;
}

/* Compute by how much the columns reduce the sum of squared residuals of a group's models, and half
   of what they add to the logarithm of the determinant (matrix inversion lemma: Rasmussen and
   Williams, Gaussian Processes for Machine Learning, 2006, A.3). */
static inline void
add_columns(const Models *m, long long group, const Work *w, const Set *set, Lanes *less,
            Lanes *logs)
{
    long long number = set->columns, pairs = number * (number + 1) / 2, all = pairs + 3 * number;
    /* Covariance and residuals at the columns if all samples were equally good. */
    memset(w->off, 0, all * sizeof(Lanes));
    add_products(m, m->left, group, set->vectors, number, NULL, 0, w->terms, w->off);
    add_products(m, m->left, group, w->modes, 3, set->vectors, number, w->terms, w->off + pairs);
    for (long long k = 0; k < (m->exact ? 0 : all); k++)
        EACH w->off[k].part[h] = set->base[k] - w->off[k].part[h];
    for (long long part = 0; part < set->parts; part++)
        logs[part] = factorize(w->off, set->weight + part * number, set->root + part * number,
                               number, set->factors + (group * set->parts + part) * pairs);
    if (set->parts == 1)
        logs[1] = logs[0];
    for (int c = 0; c < 3; c++) {
        long long part = set->parts > 1 && c > 0;
        Lanes *error = set->errors + (group * 3 + c) * number;
        memcpy(error, w->off + pairs + c * number, number * sizeof(Lanes));
        solve(set->factors + (group * set->parts + part) * pairs, set->root + part * number, number,
              error, w->scaled);
        for (long long x = 0; x < number; x++)
            less[c] = plus(less[c], error[x], w->scaled[x]);
    }
}

/* Compute the modes of the steps of a set, those of one process. */
static void
find_modes_of_steps(const Models *m, long long process, Set *set)
{
    for (int parity = 0; parity < 2; parity++) {
        const long long *first = m->first + parity * (m->processes + 1) + process;
        find_modes(m, set->folded, set->steps, first[0], first[1],
                   set->vectors + set->cells * m->rows);
    }
}

/* Compute the evidence of models, and the variance of the noise, (2, groups) each, by samples whose
   squares are found already. The rough spectrum has no steps. With steps, shorter lengths than one
   with much less evidence than a longer one of its spectrum have still less, and are left out. */
static void
find_evidence(const Models *m, const Samples *s, const Work *w, Set *set)
{
    double top[2] = {-INFINITY, -INFINITY};
    int dropped = 0;
    if (set->columns)
        find_column_products(m, s, set);
    set->best[0] = set->best[1] = -INFINITY;
    for (long long g = 0; g < m->groups; g++) {
        Lanes left[3], less[3], logs[2];
        int rough = m->kind[g * LANES] == m->kinds - 1;
        if (set->steps) {
            if (g && m->kind[g * LANES] != m->kind[(g - 1) * LANES])
                top[0] = top[1] = -INFINITY, dropped = 0;
            if (dropped || rough) {
                set->evidence[g] = set->evidence[m->groups + g] = all_lanes(-INFINITY);
                set->variance[g] = set->variance[m->groups + g] = all_lanes(1.0);
                continue;
            }
            find_modes_of_steps(m, g, set);
        }
        memset(less, 0, sizeof less), memset(logs, 0, sizeof logs);
        if (set->columns)
            add_columns(m, g, w, set, less, logs);
        for (int c = 0; c < 3; c++) {
            EACH left[c].part[h] = w->left[c * m->groups + g].part[h] - less[c].part[h];
            for (int i = 0; i < LANES; i++)
                if (((double *)(left + c))[i] < 0.0)
                    ((double *)(left + c))[i] = 0.0;
        }
        EACH left[1].part[h] += left[2].part[h];
        int lower = 1;
        for (int c = 0; c < 2; c++) {
            double number = w->known + w->seen[c] * (c + 1), *evidence, *variance, most = -INFINITY;
            evidence = (double *)(set->evidence + c * m->groups + g);
            variance = (double *)(set->variance + c * m->groups + g);
            for (int i = 0; i < LANES; i++) {
                variance[i] = (((double *)(left + c))[i] + w->known) / number;
                evidence[i] = ((const double *)(m->chances + c * m->groups + g))[i] -
                    number / 2 * log(variance[i]) - ((double *)(logs + c))[i] * (c + 1) +
                    set->prior;
                most = larger(most, evidence[i]);
            }
            if (!rough)
                set->best[c] = larger(set->best[c], most);
            lower &= most < top[c] - DROP_EVIDENCE;
            top[c] = larger(top[c], most);
        }
        dropped = lower && m->kind[g * LANES] < m->kinds;
    }
}

/* Compute the probabilities of all models with all sets, and their weights in the covariance. These
   are the square roots of the evidence, with half of the log prior of events. All spectra have the
   same total, each with line and rest, because samples contain no information on harmonics below
   the noise. The rough spectrum, the last, has less, by the root of its total. */
static void
weigh(const Models *m, int c, Set *sets, int number)
{
    long long models = m->groups * LANES, kinds = m->kinds, rough = kinds - 1;
    double best = -INFINITY, top[MOST_KINDS + 1], total[MOST_KINDS + 1] = {0};
    for (long long k = 0; k <= kinds; k++)
        top[k] = -INFINITY;
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        best = larger(best, sets[n].best[c]);
        for (long long i = 0; i < models; i++)
            top[m->kind[i]] = larger(top[m->kind[i]], evidence[i] - sets[n].prior / 2);
    }
    /* The last kind is part of all others. Those of a spectrum that is out of the question still
       count if others of their kind do not. */
    double all = -INFINITY;
    for (long long k = 0; k <= kinds; k++)
        all = k == rough ? all : larger(all, top[k]);
    double least = top[kinds];
    for (long long k = 0; k < rough; k++) {
        top[k] = larger(top[k], top[kinds]);
        least = k ? smaller(least, top[k]) : top[k];
    }
    top[kinds] = least;
    double highest = larger(all, top[rough]);
    for (int n = 0; n < number; n++) {
        const double *evidence = (const double *)(sets[n].evidence + c * m->groups);
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        double *probability = (double *)(sets[n].probability + c * m->groups);
        /* NaN is to be seen, and not to be taken for models that do not count. */
        for (long long i = 0; i < models; i++) {
            double up = evidence[i] - sets[n].prior / 2;
            long long k = m->kind[i];
            weight[i] = up < top[k] - FAR ? 0.0 : exp((up - (k == rough ? highest : all)) / 2);
            probability[i] = k == rough || evidence[i] < best - FAR ? 0.0 : exp(evidence[i] - best);
            total[k] += weight[i];
        }
    }
    double common = 0.0, sum = 0.0, total_probability = 0.0, most = 0.0;
    for (long long k = 0; k < rough; k++) {
        total[k] += total[kinds];
        most = larger(most, total[k]);
        total[k] = total[k] > 1e-300 ? 1.0 / total[k] : 0.0;
        common += total[k];
    }
    total[kinds] = common;
    /* The total of the rough spectrum over the largest of the others, 1 if it is more. */
    double part = smaller(total[rough] / most * exp((highest - all) / 2), 1.0);
    total[rough] = total[rough] > 1e-300 ? ROUGH_SHARE * sqrt(part) / total[rough] : 0.0;
    for (int n = 0; n < number; n++) {
        double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
        for (long long i = 0; i < models; i++)
            sum += weight[i] *= total[m->kind[i]];
    }
    for (int pass = 0; pass < 2; pass++)
        for (int n = 0; n < number; n++) {
            double *weight = (double *)(sets[n].covariance_weight + c * m->groups);
            double *probability = (double *)(sets[n].probability + c * m->groups);
            for (long long i = 0; i < models && pass == 0; i++) {
                weight[i] /= sum;
                if (weight[i] < LEAST_WEIGHT)
                    weight[i] = 0.0;
                if (probability[i] < LEAST_PROBABLE)
                    probability[i] = 0.0;
                total_probability += probability[i];
            }
            for (long long i = 0; i < models && pass; i++)
                probability[i] /= total_probability;
        }
}

/* Correct the derivatives of a group (3, orders) and their covariances for the columns. */
static inline void
correct(const Models *m, const Stencils *s, long long group, const Work *w, const Set *set,
        const Lanes *noisy, Lanes *derivatives, Lanes *spread)
{
    long long orders = s->orders, number = set->columns, pairs = number * (number + 1) / 2;
    Lanes *all = w->reach + orders * number;
    memset(all, 0, orders * number * sizeof(Lanes));
    add_products(m, m->share, group, s->modes, orders, set->vectors, number, w->terms, all);
    for (long long k = 0; k < orders; k++)
        for (long long x = set->cells; x < number; x++) {
            const Step *step = set->step + x - set->cells;
            if (k <= step->order)
                EACH all[k * number + x].part[h] -=
                    step_value(step->order - k, s->at - step->place);
        }
    for (long long part = 0; part < set->parts; part++) {
        memcpy(w->reach, all, orders * number * sizeof(Lanes));
        for (long long k = 0; k < orders; k++) {
            Lanes *reach = w->reach + k * number, *over = w->scaled + k * number;
            solve(set->factors + (group * set->parts + part) * pairs, set->root + part * number,
                  number, reach, over);
            for (int c = 0; c < 3; c++)
                for (long long x = 0; x < number && (set->parts == 1 || part == (c > 0)); x++)
                    derivatives[c * orders + k] = minus(derivatives[c * orders + k], over[x],
                                                  set->errors[(group * 3 + c) * number + x]);
            for (long long j = 0; j <= k; j++) {
                Lanes more = all_lanes(0.0);
                for (long long x = 0; x < number; x++)
                    more = plus(more, reach[x], w->scaled[j * number + x]);
                for (int c = 0; c < 2; c++)
                    if (set->parts == 1 || part == c) {
                        Lanes *sum = spread + (c * orders + k) * orders + j;
                        *sum = plus(*sum, noisy[c], more);
                    }
            }
        }
    }
}

/* Differentiate samples: the mean over all models, with all sets of steps, by their probabilities.
   The disagreement between models is part of the covariance. */
static void
differentiate(const Models *m, const Stencils *s, const Work *w, Set *sets, int number, Found *out)
{
    long long orders = s->orders, square = orders * orders;
    for (int c = 0; c < 2; c++)
        weigh(m, c, sets, number);
    Lanes mean[3 * MOST_ORDERS], spread[2 * MOST_ORDERS * MOST_ORDERS], parameters[2];
    memset(mean, 0, sizeof mean), memset(spread, 0, sizeof spread);
    memset(parameters, 0, sizeof parameters);
    for (long long g = 0; g < m->groups; g++) {
        Lanes without[3 * MOST_ORDERS];
        int known = 0;
        for (int n = 0; n < number; n++) {
            Set *set = sets + n;
            Lanes noisy[2], *derivatives = set->derivatives + g * 3 * orders;
            double any = 0.0;
            for (int c = 0; c < 2; c++) {
                noisy[c] = set->covariance_weight[c * m->groups + g];
                any += sum_of(noisy[c]) + sum_of(set->probability[c * m->groups + g]);
                /* The variance of a lane that is no model need not be a number. */
                for (int i = 0; i < LANES; i++)
                    if (((double *)(noisy + c))[i] != 0.0)
                        ((double *)(noisy + c))[i] *=
                            ((double *)(set->variance + c * m->groups + g))[i];
            }
            set->is_used[g] = any != 0.0;
            if (!set->is_used[g])
                continue;
            if (!known) {
                memset(without, 0, 3 * orders * sizeof(Lanes));
                add_products(m, m->share, g, w->modes, 3, s->modes, orders, w->terms, without);
            }
            known = 1;
            memcpy(derivatives, without, 3 * orders * sizeof(Lanes));
            for (int c = 0; c < 2; c++) {
                Lanes all = m->freedom[g];
                EACH all.part[h] += (double)set->events;
                parameters[c] = plus(parameters[c], set->probability[c * m->groups + g], all);
                for (long long k = 0; k < square; k++)
                    spread[c * square + k] = plus(spread[c * square + k], noisy[c],
                                                  s->spread[g * square + k]);
            }
            if (set->columns)
                correct(m, s, g, w, set, noisy, derivatives, spread);
            for (long long k = 0; k < 3 * orders; k++)
                mean[k] = plus(mean[k], set->probability[(k >= orders) * m->groups + g],
                               derivatives[k]);
        }
    }
    for (long long k = 0; k < 3 * orders; k++)
        out->mean[k / orders][k % orders] = sum_of(mean[k]);
    for (int n = 0; n < number; n++)
        for (long long g = 0; g < m->groups; g++)
            for (int c = 0; c < (sets[n].is_used[g] ? 3 : 0); c++)
                for (long long k = 0; k < orders; k++) {
                    Lanes *derivatives = sets[n].derivatives + (g * 3 + c) * orders, by;
                    EACH derivatives[k].part[h] -= out->mean[c][k];
                    by = sets[n].covariance_weight[(c > 0) * m->groups + g];
                    by = scaled(product(by, derivatives[k]), c ? 0.5 : 1.0);
                    for (long long j = 0; j <= k; j++) {
                        Lanes *sum = spread + ((c > 0) * orders + k) * orders + j;
                        *sum = plus(*sum, by, derivatives[j]);
                    }
                }
    for (int c = 0; c < 2; c++) {
        out->freedom[c] = sum_of(parameters[c]);
        for (long long k = 0; k < orders; k++)
            for (long long j = 0; j <= k; j++)
                out->covariance[c][k][j] = out->covariance[c][j][k] =
                    sum_of(spread[(c * orders + k) * orders + j]);
        for (int n = 1; n < number; n++) {
            double weight = 0.0;
            for (long long g = 0; g < m->groups; g++)
                weight += sum_of(sets[n].covariance_weight[c * m->groups + g]);
            for (long long k = 0; k < square; k++)
                out->covariance[c][k / orders][k % orders] +=
                    weight * sets[n].spread[c][k / orders][k % orders];
        }
    }
}

/* Add up how far samples at the cells are off the prediction from the others (cells, 3), in the
   mean of all models. */
static inline void
add_errors(const Models *m, const Work *w, const Set *set, double *wrong)
{
    long long number = set->columns, pairs = number * (number + 1) / 2;
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (set->is_used[g] ? 3 : 0); c++) {
            long long part = set->parts > 1 && c > 0;
            const Lanes *factor = set->factors + (g * set->parts + part) * pairs;
            const Lanes *error = set->errors + (g * 3 + c) * number;
            Lanes *own = w->scaled;
            for (long long x = number - 1; x >= 0; x--) {
                own[x] = product(error[x], factor[x * (x + 3) / 2]);
                for (long long k = x + 1; k < number; k++)
                    own[x] = minus(own[x], factor[k * (k + 1) / 2 + x], own[k]);
                wrong[x * 3 + c] += set->root[part * number + x] *
                    sum_of(product(own[x], set->probability[(c > 0) * m->groups + g]));
            }
        }
}

/* Move the samples `given` along what is found of the motion from `samples`, moved before, by
   `slopes` (SLOPES, panels, rows): derivatives of the modes at the first half of all samples. */
static void
move(const Models *m, const Lanes *slopes, const Samples *given, const Samples *samples, Work *w,
     Set *set, double *const moved[3])
{
    long long rows = m->rows, n = m->count, panels = (m->half + LANES - 1) / LANES;
    find_squares(m, samples, w);
    find_evidence(m, samples, w, set);
    for (int c = 0; c < 2; c++)
        weigh(m, c, set, 1);
    /* Derivatives (2, SLOPES, 3, panels) of even and of odd modes. */
    double *motion = w->squares;
    memset(w->along, 0, 2 * SLOPES * 3 * panels * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const Lanes probability[2] = {set->probability[g], set->probability[m->groups + g]};
        set->is_used[g] = sum_of(probability[0]) != 0.0 || sum_of(probability[1]) != 0.0;
        for (int parity = 0; parity < (set->is_used[g] ? 2 : 0); parity++) {
            const long long *first = m->first + parity * (m->processes + 1) + g / m->chunks;
            for (long long r = first[0]; r < first[1]; r++) {
                Lanes share = m->share[g % m->chunks * rows + r];
                double of_angle = sum_of(product(share, probability[0]));
                double of_position = sum_of(product(share, probability[1]));
                for (int c = 0; c < 3; c++)
                    motion[c * rows + r] = (c ? of_position : of_angle) * w->modes[c * rows + r];
            }
            for (long long k = 0; k < SLOPES * panels; k++)
                add(slopes + k * rows + first[0], first[1] - first[0], motion + first[0], rows, 3,
                    w->along + (parity * SLOPES + k / panels) * 3 * panels + k % panels, panels);
        }
    }
    for (int c = 0; c < 3; c++)
        for (long long t = 0; t < n; t++) {
            long long near = t < m->half ? t : n - 1 - t;
            double power = 1.0, sum = 0.0;
            for (int k = 0; k < SLOPES; k++) {
                double even = ((double *)(w->along + (k * 3 + c) * panels))[near];
                double odd = ((double *)(w->along + ((SLOPES + k) * 3 + c) * panels))[near];
                /* The first derivative, and the third, of what is even is odd. */
                power *= given->off[t] / (k + 1);
                sum += power * (t == near ? even + odd : k % 2 ? even - odd : odd - even);
            }
            moved[c][t] = given->x[c][t] - sum;
        }
    /* A missing sample is put where the others predict it. */
    double *wrong = w->terms;
    memset(wrong, 0, 3 * set->cells * sizeof(double));
    add_errors(m, w, set, wrong);
    for (long long x = 0; x < set->cells; x++)
        for (int c = 0; c < 3; c++)
            if (set->weight[x] <= 0.0 && set->weight[(set->parts - 1) * set->cells + x] <= 0.0)
                moved[c][set->at[x]] = samples->x[c][set->at[x]] - wrong[3 * x + c];
}
