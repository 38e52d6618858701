/*
 * The evidence of all models by even samples, and the mean and covariance of derivatives.
 *
 * LANES amplitudes of one process are a group, side by side in all arrays; a lane that is no model
 * has evidence -infinity. Each process has modes of its own, even and odd, the first of which are mean
 * and slope. The last process is rest, which has the mean only.
 */

#define LANES 8
#define PARTS (LANES / WIDTH)
/* The noise as it was measured counts for so many samples. */
#define KNOWN 300.0
/* Models with less weight than this do not count. */
#define LEAST_WEIGHT 1e-5
/* Models with so much less evidence than others do not count. */
#define FAR 80.0
/* Derivatives by which samples are moved: as many as `slopes_of` of _models.py makes. */
#define SLOPES 4
#define MOST_KINDS 8

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
} Models;

/* How modes (orders, rows) and models (groups, orders, orders) make derivatives. */
typedef struct {
    long long orders;
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
   coordinate, the number of parameters of their motions, the evidence of all models together, and
   the number of samples seen. */
#define MOST_ORDERS 5
typedef struct {
    double mean[3][MOST_ORDERS], covariance[2][MOST_ORDERS][MOST_ORDERS], freedom[2];
    double evidence[2], seen[2];
} Found;

/* The arrays of one window. `cells` are the samples that count for less than 1: their weights and
   the roots of what these lack are by angle and position, which are one part if they are equal. */
typedef struct {
    double known, seen[2], total[3];
    double *modes, *squares, *terms, *vectors, *base, *weight, *root;
    Lanes *evidence, *variance, *likely, *counting, *apart, *off, *factors, *errors, *reach;
    Lanes *scaled, *along;
    long long cells, parts, *at, *counts;
} Work;

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

/* The modes of samples, and the sums of their squares. */
static inline void
find_modes(const Models *m, const Samples *s, Work *w)
{
    long long n = m->count, half = m->half;
    double *fold = w->terms; /* (2, 3, half) */
    for (int c = 0; c < 3; c++) {
        double total = 0.0;
        for (long long t = 0; t < half; t++) {
            double a = s->x[c][t], b = s->x[c][n - 1 - t];
            fold[c * half + t] = a + b, fold[(3 + c) * half + t] = a - b;
            total += t == n - 1 - t ? a * a : a * a + b * b;
        }
        w->total[c] = total;
    }
    memset(w->modes, 0, 3 * m->rows * sizeof(double));
    for (long long r = 0; r < m->rows; r += LANES)
        add(m->panels + r / LANES * half, half, fold + (r < m->odd ? 0 : 3 * half), half, 3,
            (Lanes *)(w->modes + r), m->rows / LANES);
    for (long long i = 0; i < 3 * m->rows; i++)
        w->squares[i] = w->modes[i] * w->modes[i];
}

/* Compute the modes of cells, and the covariance and residuals (pairs + 3 cells) at the cells
   without any motion. */
static void
find_cells(const Models *m, const Samples *s, Work *w)
{
    long long number = w->cells, k = 0;
    for (long long x = 0; x < number; x++) {
        long long at = w->at[x], opposite = m->count - 1 - at, near = at < opposite ? at : opposite;
        double even = at == opposite ? 2.0 : 1.0, odd = at > opposite ? -1.0 : 1.0;
        for (long long r = 0; r < m->rows; r++)
            w->vectors[x * m->rows + r] = (r < m->odd ? even : odd) *
                ((const double *)(m->panels + r / LANES * m->half + near))[r % LANES];
    }
    for (long long i = 0; i < number + 3; i++)
        for (long long j = 0; j < (i < number ? i + 1 : number); j++)
            w->base[k++] = i < number ? i == j : s->x[i - number][w->at[j]];
}

/* `values` at cells, by the factors L D L' of their covariance: these times the roots are divided
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

/* L D L' of the covariance of cells, with the inverse of D on the diagonal; returns half of the
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

/* Compute by how much lacking samples reduce the sum of squared residuals of a group's models, and
   half of what they add to the logarithm of the determinant (matrix inversion lemma: Rasmussen and
   Williams, Gaussian Processes for Machine Learning, 2006, A.3). */
static inline void
add_lacking(const Models *m, long long group, Work *w, Lanes *less, Lanes *logs)
{
    long long number = w->cells, pairs = number * (number + 1) / 2, columns = pairs + 3 * number;
    /* Covariance and residuals at the cells if all samples were equally good. */
    memset(w->off, 0, columns * sizeof(Lanes));
    add_products(m, m->left, group, w->vectors, number, NULL, 0, w->terms, w->off);
    add_products(m, m->left, group, w->modes, 3, w->vectors, number, w->terms, w->off + pairs);
    for (long long k = 0; k < (m->exact ? 0 : columns); k++)
        EACH w->off[k].part[h] = w->base[k] - w->off[k].part[h];
    for (long long part = 0; part < w->parts; part++)
        logs[part] = factorize(w->off, w->weight + part * number, w->root + part * number, number,
                               w->factors + (group * w->parts + part) * pairs);
    if (w->parts == 1)
        logs[1] = logs[0];
    for (int c = 0; c < 3; c++) {
        long long part = w->parts > 1 && c > 0;
        Lanes *error = w->errors + (group * 3 + c) * number;
        memcpy(error, w->off + pairs + c * number, number * sizeof(Lanes));
        solve(w->factors + (group * w->parts + part) * pairs, w->root + part * number, number,
              error, w->scaled);
        for (long long x = 0; x < number; x++)
            less[c] = plus(less[c], error[x], w->scaled[x]);
    }
}

/* Probabilities of models, and their weights in covariances, by their evidence. Returns the
   evidence of all of them. For covariances evidence counts to the power of 1/2, and each kind,
   which is a spectrum with low polynomials and rest, as much as the others: how harmonics fall
   below the noise is what samples cannot tell. */
static double
weigh(const Models *m, const double *evidence, double *likely, double *weight)
{
    long long models = m->groups * LANES, kinds = m->kinds;
    double best = -INFINITY, least = INFINITY, top[MOST_KINDS + 1], total[MOST_KINDS + 1] = {0};
    for (long long k = 0; k <= kinds; k++)
        top[k] = -INFINITY;
    for (long long i = 0; i < models; i++)
        if (evidence[i] > top[m->kind[i]])
            top[m->kind[i]] = evidence[i];
    /* The last kind is part of all others. */
    for (long long k = 0; k <= kinds; k++) {
        best = larger(best, top[k]);
        top[k] = larger(top[k], top[kinds]);
        least = smaller(least, top[k]);
    }
    top[kinds] = least;
    /* NaN is to be seen, and not to be taken for models that do not count. */
    for (long long i = 0; i < models; i++) {
        weight[i] = evidence[i] < top[m->kind[i]] - FAR ? 0.0 : exp((evidence[i] - best) / 2);
        likely[i] = weight[i] * weight[i];
        total[m->kind[i]] += weight[i];
    }
    double common = 0.0, sum = 0.0, sure = 0.0;
    for (long long k = 0; k < kinds; k++) {
        total[k] += total[kinds];
        total[k] = total[k] > 1e-300 ? 1.0 / total[k] : 0.0;
        common += total[k];
    }
    total[kinds] = common;
    for (long long i = 0; i < models; i++)
        sum += weight[i] *= total[m->kind[i]];
    for (long long i = 0; i < models; i++) {
        weight[i] /= sum;
        if (weight[i] < LEAST_WEIGHT)
            weight[i] = likely[i] = 0.0;
        sure += likely[i];
    }
    for (long long i = 0; i < models; i++)
        likely[i] /= sure;
    return best + log(sure);
}

/* How probable models are by the samples: evidence, the variance of the noise, probabilities, and
   weights, (2, groups) each. */
static void
weigh_models(const Models *m, const Samples *s, Work *w, double *evidence_of_all)
{
    find_modes(m, s, w);
    if (w->cells)
        find_cells(m, s, w);
    for (long long g = 0; g < m->groups; g++) {
        Lanes left[3], less[3], logs[2];
        memset(left, 0, sizeof left), memset(less, 0, sizeof less), memset(logs, 0, sizeof logs);
        const long long *first = m->first + g / m->chunks;
        for (int parity = 0; parity < 2; parity++, first += m->processes + 1)
            add(m->left + g % m->chunks * m->rows + first[0], first[1] - first[0],
                w->squares + first[0], m->rows, 3, left, 1);
        if (w->cells)
            add_lacking(m, g, w, less, logs);
        for (int c = 0; c < 3; c++) {
            if (!m->exact)
                EACH left[c].part[h] = w->total[c] - left[c].part[h];
            EACH left[c].part[h] -= less[c].part[h];
            for (int i = 0; i < LANES; i++)
                if (((double *)(left + c))[i] < 0.0)
                    ((double *)(left + c))[i] = 0.0;
        }
        EACH left[1].part[h] += left[2].part[h];
        for (int c = 0; c < 2; c++) {
            double number = w->known + w->seen[c] * (c + 1);
            Lanes *variance = w->variance + c * m->groups + g;
            EACH variance->part[h] = (left[c].part[h] + w->known) / number;
            for (int i = 0; i < LANES; i++)
                ((double *)(w->evidence + c * m->groups + g))[i] =
                    ((const double *)(m->chances + c * m->groups + g))[i] -
                    number / 2 * log(((double *)variance)[i]) - ((double *)(logs + c))[i] * (c + 1);
        }
    }
    for (int c = 0; c < 2; c++)
        evidence_of_all[c] = weigh(m, (double *)(w->evidence + c * m->groups),
                                   (double *)(w->likely + c * m->groups),
                                   (double *)(w->counting + c * m->groups));
}

/* Correct the derivatives of a group's models (3, orders) for the lacking samples, and their
   covariances. */
static inline void
subtract_lacking(const Models *m, const Stencils *s, long long group, Work *w, const Lanes *noisy,
                 Lanes *apart, Lanes *spread)
{
    long long orders = s->orders, number = w->cells, pairs = number * (number + 1) / 2;
    for (long long part = 0; part < w->parts; part++) {
        memset(w->reach, 0, orders * number * sizeof(Lanes));
        add_products(m, m->share, group, s->modes, orders, w->vectors, number, w->terms, w->reach);
        for (long long k = 0; k < orders; k++) {
            Lanes *reach = w->reach + k * number, *over = w->scaled + k * number;
            solve(w->factors + (group * w->parts + part) * pairs, w->root + part * number, number,
                  reach, over);
            for (int c = 0; c < 3; c++)
                for (long long x = 0; x < number && (w->parts == 1 || part == (c > 0)); x++)
                    apart[c * orders + k] = minus(apart[c * orders + k], over[x],
                                                  w->errors[(group * 3 + c) * number + x]);
            for (long long j = 0; j <= k; j++) {
                Lanes more = all_lanes(0.0);
                for (long long x = 0; x < number; x++)
                    more = plus(more, reach[x], w->scaled[j * number + x]);
                for (int c = 0; c < 2; c++)
                    if (w->parts == 1 || part == c) {
                        Lanes *sum = spread + (c * orders + k) * orders + j;
                        *sum = plus(*sum, noisy[c], more);
                    }
            }
        }
    }
}

/* Differentiate samples: the mean over all models by their probabilities. The disagreement between
   models is part of the covariance. */
static void
differentiate(const Models *m, const Stencils *s, const Samples *samples, Work *w, Found *out)
{
    long long orders = s->orders, square = orders * orders;
    weigh_models(m, samples, w, out->evidence);
    Lanes mean[3 * MOST_ORDERS], spread[2 * MOST_ORDERS * MOST_ORDERS], parameters[2];
    memset(mean, 0, sizeof mean), memset(spread, 0, sizeof spread);
    memset(parameters, 0, sizeof parameters);
    for (long long g = 0; g < m->groups; g++) {
        Lanes noisy[2], *apart = w->apart + g * 3 * orders;
        double any = 0.0;
        for (int c = 0; c < 2; c++) {
            noisy[c] = w->counting[c * m->groups + g];
            any += sum_of(noisy[c]);
            /* The variance of a lane that is no model need not be a number. */
            for (int i = 0; i < LANES; i++)
                if (((double *)(noisy + c))[i] != 0.0)
                    ((double *)(noisy + c))[i] *= ((double *)(w->variance + c * m->groups + g))[i];
        }
        w->counts[g] = any != 0.0;
        if (!w->counts[g])
            continue;
        memset(apart, 0, 3 * orders * sizeof(Lanes));
        add_products(m, m->share, g, w->modes, 3, s->modes, orders, w->terms, apart);
        for (int c = 0; c < 2; c++) {
            parameters[c] = plus(parameters[c], w->likely[c * m->groups + g], m->freedom[g]);
            for (long long k = 0; k < square; k++)
                spread[c * square + k] = plus(spread[c * square + k], noisy[c],
                                              s->spread[g * square + k]);
        }
        if (w->cells)
            subtract_lacking(m, s, g, w, noisy, apart, spread);
        for (long long k = 0; k < 3 * orders; k++)
            mean[k] = plus(mean[k], w->likely[(k >= orders) * m->groups + g], apart[k]);
    }
    for (long long k = 0; k < 3 * orders; k++)
        out->mean[k / orders][k % orders] = sum_of(mean[k]);
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (w->counts[g] ? 3 : 0); c++)
            for (long long k = 0; k < orders; k++) {
                Lanes *apart = w->apart + (g * 3 + c) * orders, by;
                EACH apart[k].part[h] -= out->mean[c][k];
                by = scaled(product(w->counting[(c > 0) * m->groups + g], apart[k]), c ? 0.5 : 1.0);
                for (long long j = 0; j <= k; j++) {
                    Lanes *sum = spread + ((c > 0) * orders + k) * orders + j;
                    *sum = plus(*sum, by, apart[j]);
                }
            }
    for (int c = 0; c < 2; c++) {
        out->freedom[c] = sum_of(parameters[c]);
        out->seen[c] = w->seen[c];
        for (long long k = 0; k < orders; k++)
            for (long long j = 0; j <= k; j++)
                out->covariance[c][k][j] = out->covariance[c][j][k] =
                    sum_of(spread[(c * orders + k) * orders + j]);
    }
}

/* Add up how far samples at the cells are off the prediction from the others (cells, 3), in the
   mean of all models. */
static inline void
add_errors(const Models *m, Work *w, double *wrong)
{
    long long number = w->cells, pairs = number * (number + 1) / 2;
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (w->counts[g] ? 3 : 0); c++) {
            long long part = w->parts > 1 && c > 0;
            const Lanes *factor = w->factors + (g * w->parts + part) * pairs;
            const Lanes *error = w->errors + (g * 3 + c) * number;
            Lanes *own = w->scaled;
            for (long long x = number - 1; x >= 0; x--) {
                own[x] = product(error[x], factor[x * (x + 3) / 2]);
                for (long long k = x + 1; k < number; k++)
                    own[x] = minus(own[x], factor[k * (k + 1) / 2 + x], own[k]);
                wrong[x * 3 + c] += w->root[part * number + x] *
                    sum_of(product(own[x], w->likely[(c > 0) * m->groups + g]));
            }
        }
}

/* Move the samples `given` along what is found of the motion from `samples`, moved before, by
   `slopes` (SLOPES, panels, rows): derivatives of the modes at the first half of all samples. */
static void
move(const Models *m, const Lanes *slopes, const Samples *given, const Samples *samples, Work *w,
     double *const moved[3])
{
    long long rows = m->rows, n = m->count, panels = (m->half + LANES - 1) / LANES;
    double evidence[2];
    weigh_models(m, samples, w, evidence);
    /* Derivatives (2, SLOPES, 3, panels) of even and of odd modes. */
    double *motion = w->squares;
    memset(w->along, 0, 2 * SLOPES * 3 * panels * sizeof(Lanes));
    for (long long g = 0; g < m->groups; g++) {
        const Lanes likely[2] = {w->likely[g], w->likely[m->groups + g]};
        w->counts[g] = sum_of(likely[0]) != 0.0 || sum_of(likely[1]) != 0.0;
        for (int parity = 0; parity < (w->counts[g] ? 2 : 0); parity++) {
            const long long *first = m->first + parity * (m->processes + 1) + g / m->chunks;
            for (long long r = first[0]; r < first[1]; r++) {
                Lanes share = m->share[g % m->chunks * rows + r];
                double of_angle = sum_of(product(share, likely[0]));
                double of_position = sum_of(product(share, likely[1]));
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
    memset(wrong, 0, 3 * w->cells * sizeof(double));
    add_errors(m, w, wrong);
    for (long long x = 0; x < w->cells; x++)
        for (int c = 0; c < 3; c++)
            if (w->weight[x] <= 0.0 && w->weight[(w->parts - 1) * w->cells + x] <= 0.0)
                moved[c][w->at[x]] = samples->x[c][w->at[x]] - wrong[3 * x + c];
}
