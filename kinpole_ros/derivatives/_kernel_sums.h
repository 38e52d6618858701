/*
 * The sums of _kernel.c, for one kind of processor: that file includes this one for each of them,
 * and names their functions by NAME. Vectors are of WIDTH numbers. Compilers break up those that a
 * processor does not have before they inline or clone functions, and badly, so nothing but to
 * compile the text again makes them as wide as the processor's.
 */

typedef double NAME(Vector) __attribute__((vector_size(8 * WIDTH), aligned(8), may_alias));
#define Vector NAME(Vector)
#define PARTS (LANES / WIDTH)

/* out (columns, LANES), `step` apart, += values (columns, depth), `stride` apart, times table
   (depth, LANES). Three columns are done at once, so that sums need not wait for each other. */
static inline void
NAME(add)(const double *table, long long depth, const double *values, long long stride, long long columns,
          double *out, long long step)
{
    for (; columns >= 3; columns -= 3, values += 3 * stride, out += 3 * step) {
        Vector x[PARTS], y[PARTS], z[PARTS];
        for (int h = 0; h < PARTS; h++) {
            x[h] = ((Vector *)out)[h];
            y[h] = ((Vector *)(out + step))[h];
            z[h] = ((Vector *)(out + 2 * step))[h];
        }
        for (long long k = 0; k < depth; k++)
            for (int h = 0; h < PARTS; h++) {
                Vector by = ((const Vector *)(table + k * LANES))[h];
                x[h] += by * values[k];
                y[h] += by * values[stride + k];
                z[h] += by * values[2 * stride + k];
            }
        for (int h = 0; h < PARTS; h++) {
            ((Vector *)out)[h] = x[h];
            ((Vector *)(out + step))[h] = y[h];
            ((Vector *)(out + 2 * step))[h] = z[h];
        }
    }
    for (; columns > 0; columns--, values += stride, out += step) {
        Vector x[PARTS];
        for (int h = 0; h < PARTS; h++)
            x[h] = ((Vector *)out)[h];
        for (long long k = 0; k < depth; k++)
            for (int h = 0; h < PARTS; h++)
                x[h] += ((const Vector *)(table + k * LANES))[h] * values[k];
        for (int h = 0; h < PARTS; h++)
            ((Vector *)out)[h] = x[h];
    }
}

/* out (LANES) += factor (LANES) times values (LANES). */
static inline void
NAME(multiply)(double *out, const double *factor, const double *values)
{
    for (int h = 0; h < PARTS; h++)
        ((Vector *)out)[h] += ((const Vector *)factor)[h] * ((const Vector *)values)[h];
}

static inline void
NAME(fill)(double *out, double value)
{
    for (int i = 0; i < LANES; i++)
        out[i] = value;
}

/* out (LANES) are sums of the products of left (a, rows) and right (b, rows), of each row by each,
   or of each two of left if there is no right, over the modes of a group's process. */
static inline void
NAME(products)(const Models *m, const double *table, long long group, const double *left, long long a,
               const double *right, long long b, double *terms, double *out)
{
    if (group == m->groups - 1)
        return; /* rest has no modes beside the mean */
    const long long *first = m->first + group / m->chunks;
    table += group % m->chunks * m->rows * LANES;
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        long long begin = first[0], depth = first[1] - begin, columns = 0;
        for (long long i = 0; i < a; i++)
            for (long long j = 0; j < (right ? b : i + 1); j++, columns++) {
                const double *x = left + i * m->rows + begin;
                const double *y = (right ? right : left) + j * m->rows + begin;
                for (long long k = 0; k < depth; k++)
                    terms[columns * depth + k] = x[k] * y[k];
            }
        NAME(add)(table + begin * LANES, depth, terms, depth, columns, out, LANES);
    }
}

/* The modes (3, rows) of samples, and how large these are beside the mean (3,). */
static inline void
NAME(project)(const Models *m, const double *samples, long long bodies, Work *w)
{
    long long n = m->count, half = m->half;
    double *fold = w->terms; /* (2, 3, half) */
    for (int c = 0; c < 3; c++) {
        double total = 0.0;
        for (long long t = 0; t < half; t++) {
            double a = samples[(3 * t + c) * bodies], b = samples[(3 * (n - 1 - t) + c) * bodies];
            fold[c * half + t] = a + b;
            fold[(3 + c) * half + t] = a - b;
            total += t == n - 1 - t ? a * a : a * a + b * b;
        }
        w->total[c] = total;
    }
    memset(w->modes, 0, 3 * m->rows * sizeof(double));
    for (long long r = 0; r < m->rows; r += LANES)
        NAME(add)(m->panels + r * half, half, fold + (r < m->even ? 0 : 3 * half), half, 3,
                  w->modes + r, m->rows);
    for (int c = 0; c < 3; c++)
        w->total[c] -= w->modes[c * m->rows] * w->modes[c * m->rows];
}

/* What is off at cells, `values` (X, LANES), by the factors L D L' of its covariance: these times
   `root` are divided by L, and `scaled` are the same over D. */
static inline void
NAME(solve)(const double *factor, const double *root, long long number, double *values, double *scaled)
{
    for (long long x = 0; x < number; x++) {
        const double *row = factor + x * (x + 1) / 2 * LANES;
        for (int h = 0; h < PARTS; h++) {
            Vector sum = ((Vector *)(values + x * LANES))[h] * root[x];
            for (long long k = 0; k < x; k++)
                sum -= ((const Vector *)row)[PARTS * k + h] * ((Vector *)values)[PARTS * k + h];
            ((Vector *)values)[PARTS * x + h] = sum;
            ((Vector *)scaled)[PARTS * x + h] = sum * ((const Vector *)row)[PARTS * x + h];
        }
    }
}

/* By how much the squares of what models leave are smaller for what is lacking, `rest` (3, LANES),
   and half of the logarithm of their determinant larger, `log` (2, LANES), of a group. */
static inline void
NAME(lack)(const Models *m, const Cells *cells, long long group, Work *w, double *rest, double *logs)
{
    long long number = cells->number, pairs = number * (number + 1) / 2, columns = pairs + 3 * number;
    int isrest = group == m->groups - 1;
    /* What is off at the cells if all are as good: its covariance (pairs), and itself (3 X). */
    double *off = w->off;
    memset(off, 0, columns * LANES * sizeof(double));
    NAME(products)(m, m->left, group, cells->modes, number, NULL, 0, w->terms, off);
    NAME(products)(m, m->left, group, w->modes, 3, cells->modes, number, w->terms,
                   off + pairs * LANES);
    if (!m->exact || isrest)
        for (long long k = 0; k < columns; k++)
            for (int i = 0; i < LANES; i++)
                off[k * LANES + i] = w->base[isrest * columns + k] - off[k * LANES + i];
    for (long long part = 0; part < cells->parts; part++) {
        const double *weight = cells->weight + part * number, *root = cells->root + part * number;
        double *factor = w->factors + (group * cells->parts + part) * pairs * LANES;
        /* L D L', with the inverse of D on the diagonal. */
        Vector product[PARTS], sum[PARTS];
        memset(logs + part * LANES, 0, LANES * sizeof(double));
        for (int h = 0; h < PARTS; h++)
            product[h] = (Vector){0} + 1.0;
        for (long long i = 0; i < number; i++) {
            Vector *row = (Vector *)(factor + i * (i + 1) / 2 * LANES);
            for (long long j = 0; j <= i; j++) {
                Vector *other = (Vector *)(factor + j * (j + 1) / 2 * LANES);
                for (int h = 0; h < PARTS; h++) {
                    sum[h] = ((Vector *)(off + (i * (i + 1) / 2 + j) * LANES))[h];
                    sum[h] *= root[i] * root[j];
                    if (i == j) {
                        sum[h] += weight[i];
                        /* Until now it is L times D. */
                        for (long long k = 0; k < i; k++) {
                            Vector before = row[PARTS * k + h];
                            row[PARTS * k + h] *= ((Vector *)(factor + k * (k + 3) / 2 * LANES))[h];
                            sum[h] -= before * row[PARTS * k + h];
                        }
                        product[h] *= sum[h];
                        row[PARTS * i + h] = 1.0 / sum[h];
                    } else {
                        for (long long k = 0; k < j; k++)
                            sum[h] -= row[PARTS * k + h] * other[PARTS * k + h];
                        row[PARTS * j + h] = sum[h];
                    }
                }
            }
            /* Few logarithms, but no product that vanishes. */
            if (i % 8 == 7 || i == number - 1)
                for (int h = 0; h < LANES; h++) {
                    logs[part * LANES + h] += log(((double *)product)[h]) / 2;
                    ((double *)product)[h] = 1.0;
                }
        }
    }
    if (cells->parts == 1)
        memcpy(logs + LANES, logs, LANES * sizeof(double));
    for (int c = 0; c < 3; c++) {
        long long part = cells->parts > 1 && c > 0;
        double *error = w->errors + (group * 3 + c) * number * LANES;
        memcpy(error, off + (pairs + c * number) * LANES, number * LANES * sizeof(double));
        NAME(solve)(w->factors + (group * cells->parts + part) * pairs * LANES,
                    cells->root + part * number, number, error, w->scaled);
        for (long long x = 0; x < number; x++)
            NAME(multiply)(rest + c * LANES, error + x * LANES, w->scaled + x * LANES);
    }
}

/* How probable models are by one signal: evidence, the variance of the noise, probabilities, and
   weights, (2, groups, LANES) each. */
static inline void
NAME(judge)(const Models *m, const double *samples, long long bodies, const double *seen,
            const Cells *cells, Work *w)
{
    long long lanes = m->groups * LANES, rows = m->rows, number = cells->number;
    NAME(project)(m, samples, bodies, w);
    for (long long i = 0; i < 3 * rows; i++)
        w->squares[i] = w->modes[i] * w->modes[i];
    if (number)
        gather(m, samples, bodies, cells, w);
    for (long long g = 0; g < m->groups; g++) {
        double rest[3 * LANES] = {0}, less[3 * LANES] = {0}, logs[2 * LANES] = {0};
        int isrest = g == m->groups - 1;
        if (!isrest) {
            const double *table = m->left + g % m->chunks * rows * LANES;
            const long long *first = m->first + g / m->chunks;
            for (int parity = 0; parity < 2; parity++, first += m->processes + 1)
                NAME(add)(table + first[0] * LANES, first[1] - first[0], w->squares + first[0],
                          rows, 3, rest, LANES);
        }
        if (number)
            NAME(lack)(m, cells, g, w, less, logs);
        for (int c = 0; c < 3; c++)
            for (int i = 0; i < LANES; i++) {
                double line = isrest ? 0.0 : w->squares[c * rows + m->even];
                double all = w->total[c] - line, own = rest[c * LANES + i];
                own = (m->exact && !isrest ? own : all - own) - less[c * LANES + i];
                rest[c * LANES + i] = own < 0.0 ? 0.0 : own;
            }
        for (int i = 0; i < LANES; i++)
            rest[LANES + i] += rest[2 * LANES + i];
        for (int c = 0; c < 2; c++)
            for (int i = 0; i < LANES; i++) {
                long long k = c * lanes + g * LANES + i;
                double total = m->known + seen[c * bodies] * (c + 1);
                w->variance[k] = (rest[c * LANES + i] + m->known) / total;
                w->evidence[k] = m->chances[k] - total / 2 * log(w->variance[k]);
                w->evidence[k] -= logs[c * LANES + i] * (c + 1);
            }
    }
    for (int c = 0; c < 2; c++)
        w->whole[c] = weigh(m, w->evidence + c * lanes, w->likely + c * lanes,
                            w->weight + c * lanes);
}

/* What models say of one signal: derive of _evidence.py. */
static void
NAME(differentiate)(const Models *m, const Stencils *s, const double *samples, long long bodies,
                    const double *seen, const Cells *cells, Work *w, const Result *out)
{
    long long lanes = m->groups * LANES, orders = s->orders, number = cells->number;
    long long pairs = number * (number + 1) / 2;
    NAME(judge)(m, samples, bodies, seen, cells, w);
    /* What models that count make of the signal, (groups, 3, orders, LANES), and its mean. */
    memset(w->mean, 0, 3 * orders * LANES * sizeof(double));
    memset(w->spread, 0, 2 * orders * orders * LANES * sizeof(double));
    double parameters[2 * LANES] = {0};
    for (long long g = 0; g < m->groups; g++) {
        double noisy[2 * LANES], *apart = w->apart + g * 3 * orders * LANES;
        double any = 0.0;
        for (int c = 0; c < 2; c++)
            for (int i = 0; i < LANES; i++) {
                long long k = c * lanes + g * LANES + i;
                any += w->weight[k];
                noisy[c * LANES + i] = w->weight[k] > 0.0 ? w->weight[k] * w->variance[k] : 0.0;
            }
        w->counts[g] = any != 0.0;
        if (!w->counts[g])
            continue;
        for (int c = 0; c < 2; c++)
            NAME(multiply)(parameters + c * LANES, w->likely + c * lanes + g * LANES,
                           m->freedom + g * LANES);
        line(m, s->modes, orders, w->modes, 3, g, apart, 1);
        NAME(products)(m, m->share, g, w->modes, 3, s->modes, orders, w->terms, apart);
        /* Covariances (2, orders, orders, LANES), of angle and position. */
        for (int c = 0; c < 2; c++)
            for (long long k = 0; k < orders * orders; k++)
                NAME(multiply)(w->spread + (c * orders * orders + k) * LANES, noisy + c * LANES,
                               s->spread + (g * orders * orders + k) * LANES);
        for (long long part = 0; part < (number ? cells->parts : 0); part++) {
            const double *factor = w->factors + (g * cells->parts + part) * pairs * LANES;
            line(m, s->modes, orders, cells->modes, number, g, w->reach, 0);
            NAME(products)(m, m->share, g, s->modes, orders, cells->modes, number, w->terms,
                           w->reach);
            for (long long k = 0; k < orders; k++) {
                double *reach = w->reach + k * number * LANES;
                double *scaled = w->scaled + k * number * LANES;
                NAME(solve)(factor, cells->root + part * number, number, reach, scaled);
                for (int c = 0; c < 3; c++)
                    for (long long x = 0; x < number && (cells->parts == 1 || part == (c > 0)); x++)
                        for (int i = 0; i < LANES; i++)
                            apart[(c * orders + k) * LANES + i] -= scaled[x * LANES + i] *
                                w->errors[((g * 3 + c) * number + x) * LANES + i];
                for (long long j = 0; j <= k; j++) {
                    double more[LANES] = {0};
                    for (long long x = 0; x < number; x++)
                        NAME(multiply)(more, reach + x * LANES,
                                       w->scaled + (j * number + x) * LANES);
                    for (int c = 0; c < 2; c++)
                        if (cells->parts == 1 || part == c)
                            NAME(multiply)(w->spread + ((c * orders + k) * orders + j) * LANES,
                                           noisy + c * LANES, more);
                }
            }
        }
        for (int c = 0; c < 3; c++)
            for (long long k = 0; k < orders; k++)
                NAME(multiply)(w->mean + (c * orders + k) * LANES,
                               w->likely + (c > 0) * lanes + g * LANES,
                               apart + (c * orders + k) * LANES);
    }
    for (long long k = 0; k < 3 * orders; k++) {
        double mean = sum_of(w->mean + k * LANES);
        out->mean[(k % orders * 3 + k / orders) * bodies] = mean;
        for (long long g = 0; g < m->groups; g++)
            for (int i = 0; i < (w->counts[g] ? LANES : 0); i++)
                w->apart[(g * 3 * orders + k) * LANES + i] -= mean;
    }
    /* What the models disagree about. */
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (w->counts[g] ? 3 : 0); c++)
            for (long long k = 0; k < orders; k++) {
                double by[LANES], *apart = w->apart + (g * 3 + c) * orders * LANES;
                for (int i = 0; i < LANES; i++)
                    by[i] = w->weight[(c > 0) * lanes + g * LANES + i] * apart[k * LANES + i] /
                        (c > 0 ? 2 : 1);
                for (long long j = 0; j <= k; j++)
                    NAME(multiply)(w->spread + (((c > 0) * orders + k) * orders + j) * LANES, by,
                                   apart + j * LANES);
            }
    for (int c = 0; c < 2; c++) {
        out->summary[c * bodies] = sum_of(parameters + c * LANES);
        out->summary[(2 + c) * bodies] = w->whole[c];
        for (long long k = 0; k < orders; k++)
            for (long long j = 0; j <= k; j++) {
                double sum = sum_of(w->spread + ((c * orders + k) * orders + j) * LANES);
                out->covariance[((k * orders + j) * 2 + c) * bodies] = sum;
                out->covariance[((j * orders + k) * 2 + c) * bodies] = sum;
            }
    }
}

/* By how much what is missing is off, (X, 3), in the mean of the models that count. */
static inline void
NAME(restore)(const Models *m, const Cells *cells, Work *w, double *wrong)
{
    long long number = cells->number, pairs = number * (number + 1) / 2;
    for (long long g = 0; g < m->groups; g++)
        for (int c = 0; c < (w->counts[g] ? 3 : 0); c++) {
            long long part = cells->parts > 1 && c > 0;
            const double *factor = w->factors + (g * cells->parts + part) * pairs * LANES;
            const double *error = w->errors + (g * 3 + c) * number * LANES;
            double *own = w->scaled;
            for (long long x = number - 1; x >= 0; x--) {
                double sum[LANES] = {0};
                for (int h = 0; h < PARTS; h++) {
                    Vector left = ((const Vector *)(error + x * LANES))[h] *
                                ((const Vector *)(factor + x * (x + 3) / 2 * LANES))[h];
                    for (long long k = x + 1; k < number; k++)
                        left -= ((const Vector *)(factor + (k * (k + 1) / 2 + x) * LANES))[h] *
                                ((Vector *)own)[PARTS * k + h];
                    ((Vector *)own)[PARTS * x + h] = left;
                }
                NAME(multiply)(sum, own + x * LANES,
                               w->likely + ((c > 0) * m->groups + g) * LANES);
                wrong[x * 3 + c] += cells->root[part * number + x] * sum_of(sum);
            }
        }
}

/* The samples of one signal moved along what is found of it: _moved_once of _samples.py. `slopes`
   (SLOPES, panels, rows, LANES) are derivatives of the modes at the first half of all samples. */
static void
NAME(move)(const Models *m, const double *slopes, const double *given, const double *samples,
           const double *off, long long bodies, const double *seen, const Cells *cells, Work *w,
           double *moved)
{
    long long rows = m->rows, n = m->count;
    long long panels = (m->half + LANES - 1) / LANES, half = panels * LANES;
    NAME(judge)(m, samples, bodies, seen, cells, w);
    /* Derivatives (2, SLOPES, 3, half) of even and of odd modes. */
    double *motion = w->squares, *along = w->along, moving[2] = {0};
    memset(along, 0, 2 * SLOPES * 3 * half * sizeof(double));
    for (long long g = 0; g < m->groups; g++) {
        double sum[2];
        for (int c = 0; c < 2; c++) {
            sum[c] = sum_of(w->likely + (c * m->groups + g) * LANES);
            moving[c] += g < m->groups - 1 ? sum[c] : 0.0;
        }
        w->counts[g] = sum[0] != 0.0 || sum[1] != 0.0;
    }
    for (int c = 0; c < 3; c++)
        motion[c * rows + m->even] = moving[c > 0] * w->modes[c * rows + m->even];
    /* The slope, and then all groups. */
    for (long long g = -1; g < m->groups - 1; g++) {
        if (g >= 0 && !w->counts[g])
            continue;
        for (int parity = g < 0; parity < 2; parity++) {
            const long long *first = m->first + parity * (m->processes + 1) + g / m->chunks;
            long long begin = g < 0 ? m->even : first[0], depth = g < 0 ? 1 : first[1] - begin;
            for (long long r = begin; g >= 0 && r < begin + depth; r++) {
                const double *share = m->share + (g % m->chunks * rows + r) * LANES;
                double part[2 * LANES] = {0};
                for (int c = 0; c < 2; c++)
                    NAME(multiply)(part + c * LANES, share,
                                   w->likely + (c * m->groups + g) * LANES);
                for (int c = 0; c < 3; c++)
                    motion[c * rows + r] = sum_of(part + (c > 0) * LANES) * w->modes[c * rows + r];
            }
            for (long long k = 0; k < SLOPES * panels; k++)
                NAME(add)(slopes + (k * rows + begin) * LANES, depth, motion + begin, rows, 3,
                          along + (parity * SLOPES + k / panels) * 3 * half + k % panels * LANES,
                          half);
        }
    }
    for (long long t = 0; t < n; t++)
        for (int c = 0; c < 3; c++) {
            long long near = t < m->half ? t : n - 1 - t;
            double power = 1.0, by = off[t * bodies], sum = 0.0;
            for (int k = 0; k < SLOPES; k++) {
                double even = along[(k * 3 + c) * half + near];
                double odd = along[((SLOPES + k) * 3 + c) * half + near];
                /* The first derivative, and the third, of what is even is odd. */
                power *= by / (k + 1);
                sum += power * (t == near ? even + odd : k % 2 ? even - odd : odd - even);
            }
            moved[(3 * t + c) * bodies] = given[(3 * t + c) * bodies] - sum;
        }
    /* What is missing is where the others have it. */
    long long number = cells->number;
    if (number) {
        double *wrong = w->reach;
        memset(wrong, 0, 3 * number * sizeof(double));
        NAME(restore)(m, cells, w, wrong);
        for (long long x = 0; x < number; x++)
            for (int c = 0; c < 3; c++) {
                long long at = (3 * cells->at[x] + c) * bodies;
                long long last = (cells->parts - 1) * number + x;
                if (cells->weight[x] <= 0.0 && cells->weight[last] <= 0.0)
                    moved[at] = samples[at] - wrong[x * 3 + c];
            }
    }
}

#undef Vector
#undef PARTS
