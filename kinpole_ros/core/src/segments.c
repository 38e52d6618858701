#include <math.h>
#include <string.h>

#include "segments.h"
#include "memory.h"
#include "numbers.h"

/* Highest degree in a segment: that of free flight. The covariance is that of a polynomial MORE_DEGREES higher,
   because the samples do not show what is below their noise. */
#define DEGREE 2
#define MORE_DEGREES 2
#define COLUMNS MAX_ORDERS
/* Log evidence that a coefficient costs, about the logarithm of how far it exceeds its noise; and an event, of the
   number of its places. */
#define COEFFICIENT_COST 5.0
#define EVENT_COST 12.0
/* Samples of the shortest segment. */
#define MIN_LENGTH 3
/* Segments around the instant that count, and the log evidence by which others may be behind the best. */
#define MAX_KEPT 8
#define MAX_BEHIND 10.0

/* All segments of a window, by part: the log evidence of those of length k + 1, by their first sample (count, count);
   the best evidence of the samples before and from each one on (count + 1). */
typedef struct {
    long long count;
    double *root;       /* (count): of the weights */
    long long *present; /* (count + 1): how many samples before each one are not missing */
    double *value[2], *before[2], *after[2];
} Division;

/* The polynomials of all segments of one length, by their first sample (count). */
typedef struct {
    double *factor[DEGREE + 1][DEGREE + 1], *along[DEGREE + 1][3], *squares[3];
    double *row[DEGREE + 1], *cosine, *sine, *x[3];
} Fits;

static inline void
find_rotation(double own, double other, double *cosine, double *sine)
{
    double size = sqrt(own * own + other * other);
    *cosine = size > 0.0 ? own / size : 1.0;
    *sine = size > 0.0 ? other / size : 0.0;
}

static inline void
rotate(double cosine, double sine, double *own, double *other)
{
    double old = *own;
    *own = cosine * old + sine * *other;
    *other = cosine * *other - sine * old;
}

/* Rotate one more sample, the one `last` after the first, into all segments that it extends. If all samples count
   alike, so do all segments of a length. */
static void
extend_segments(const Samples *s, const Division *d, int is_even, long long last, Fits *f)
{
    long long segments = d->count - last, distinct = is_even ? 1 : segments;
    double time = last / (double)d->count;
    for (long long i = 0; i < distinct; i++)
        for (int k = 0; k <= DEGREE; k++)
            f->row[k][i] = k ? f->row[k - 1][i] * time : d->root[i + last];
    for (int c = 0; c < 3; c++)
        for (long long i = 0; i < segments; i++)
            f->x[c][i] = d->root[i + last] * s->x[c][i + last];
    for (int k = 0; k <= DEGREE; k++) {
        for (long long i = 0; i < distinct; i++) {
            find_rotation(f->factor[k][k][i], f->row[k][i], f->cosine + i, f->sine + i);
            for (int l = k; l <= DEGREE; l++)
                rotate(f->cosine[i], f->sine[i], f->factor[k][l] + i, f->row[l] + i);
        }
        for (long long i = distinct; i < segments; i++)
            f->cosine[i] = f->cosine[0], f->sine[i] = f->sine[0];
        for (int c = 0; c < 3; c++) {
            double *restrict along = f->along[k][c], *restrict x = f->x[c];
            const double *restrict cosine = f->cosine, *restrict sine = f->sine;
            for (long long i = 0; i < segments; i++)
                rotate(cosine[i], sine[i], along + i, x + i);
        }
    }
    for (int c = 0; c < 3; c++)
        for (long long i = 0; i < segments; i++)
            f->squares[c][i] += f->x[c][i] * f->x[c][i];
}

/* Return the log evidence of the best degree of a segment of this length, by the `squares` that the highest degree
   leaves, and those of each coefficient, both summed over the signals of a part. */
static inline double
best_degree(int part, long long length, double squares, const double *of_degree, int *degree)
{
    double cost = COEFFICIENT_COST * (part + 1), best = -INFINITY;
    double value = -squares / 2 - (DEGREE + 1) * cost - EVENT_COST;
    for (int k = DEGREE; k >= 0; k--) {
        int is_better = k + 2 <= length && value > best;
        best = is_better ? value : best, *degree = is_better ? k : *degree;
        value += cost - of_degree[k] / 2;
    }
    return length < MIN_LENGTH ? -INFINITY : best;
}

/* Lay out the arrays of a window, and find the evidence of all of its segments. */
static int
evaluate_segments(Call *call, const Samples *s, Division *d)
{
    long long n = s->count;
    int is_even = 1, degree;
    size_t of_fits = (DEGREE + 1) * (DEGREE + 1 + 3 + 1) + 3 + 2 + 3;
    char *data = kinpole_buffer(call, OF_SEGMENTS, ((of_fits + 6 + 2 * n) * n + 5) * sizeof(double));
    Fits f;
    if (!data)
        return NO_MEMORY;
    memset(data, 0, of_fits * n * sizeof(double));
    for (int k = 0; k <= DEGREE; k++) {
        TAKE(f.row[k], n);
        for (int l = 0; l <= DEGREE; l++)
            TAKE(f.factor[k][l], n);
        for (int c = 0; c < 3; c++)
            TAKE(f.along[k][c], n);
    }
    for (int c = 0; c < 3; c++)
        TAKE(f.squares[c], n), TAKE(f.x[c], n);
    TAKE(f.cosine, n), TAKE(f.sine, n), TAKE(d->root, n), TAKE(d->present, n + 1);
    for (int part = 0; part < 2; part++)
        TAKE(d->value[part], n * n), TAKE(d->before[part], n + 1), TAKE(d->after[part], n + 1);
    d->count = n, d->present[0] = 0;
    for (long long t = 0; t < n; t++) {
        d->root[t] = sqrt(smaller(s->weight[0][t], s->weight[1][t]));
        d->present[t + 1] = d->present[t] + (d->root[t] > 0.0);
        is_even &= d->root[t] == 1.0;
    }
    for (long long last = 0; last < n; last++) {
        extend_segments(s, d, is_even, last, &f);
        for (long long i = 0; i < n - last; i++) {
            double of_degree[2][DEGREE + 1];
            long long length = d->present[i + last + 1] - d->present[i];
            for (int k = 0; k <= DEGREE; k++) {
                double *const *z = f.along[k];
                of_degree[0][k] = z[0][i] * z[0][i];
                of_degree[1][k] = z[1][i] * z[1][i] + z[2][i] * z[2][i];
            }
            d->value[0][last * n + i] = best_degree(0, length, f.squares[0][i], of_degree[0], &degree);
            d->value[1][last * n + i] =
                best_degree(1, length, f.squares[1][i] + f.squares[2][i], of_degree[1], &degree);
        }
    }
    return DONE;
}

/* Find the best evidence of the samples before each one, and from it on. The first segment is not after an event, and
   its mean and slope cost nothing, as those of the models. */
static void
divide(const Division *d, int part)
{
    long long n = d->count;
    double *before = d->before[part], *after = d->after[part];
    before[0] = EVENT_COST + 2 * COEFFICIENT_COST * (part + 1), after[n] = 0.0;
    for (long long end = 1; end <= n; end++) {
        before[end] = -INFINITY;
        for (long long first = 0; first < end; first++)
            before[end] = larger(before[end],
                                 before[first] + d->value[part][(end - 1 - first) * n + first]);
    }
    for (long long first = n - 1; first >= 0; first--) {
        after[first] = -INFINITY;
        for (long long end = first + 1; end <= n; end++)
            after[first] =
                larger(after[first], after[end] + d->value[part][(end - 1 - first) * n + first]);
    }
}

/* Samples from `first` to before `end`, and the evidence of the best division that has them as a segment. */
typedef struct {
    long long first, end;
    double value;
} Segment;

/* Find the best segments around the instant, at most MAX_KEPT, the best first; returns how many. */
static int
keep_segments(const Division *d, int part, double at, Segment *kept)
{
    long long n = d->count;
    double least = d->before[part][n] - MAX_BEHIND;
    int number = 0;
    for (long long first = 0; first - 0.5 <= at && first < n; first++)
        for (long long end = (long long)floor(at + 0.5) + 1; end <= n; end++) {
            double value = d->before[part][first] + d->after[part][end] +
                d->value[part][(end - 1 - first) * n + first];
            if (!(value > least))
                continue;
            int k = number < MAX_KEPT ? number++ : MAX_KEPT - 1;
            for (; k > 0 && kept[k - 1].value < value; k--)
                kept[k] = kept[k - 1];
            kept[k] = (Segment){first, end, value};
            if (number == MAX_KEPT)
                least = kept[MAX_KEPT - 1].value;
        }
    return number;
}

/* The derivatives of a segment at the instant: means (3, orders), and deviations as vectors over the coefficients of
   the polynomial. */
typedef struct {
    int degree, highest[MAX_ORDERS];
    double mean[3][MAX_ORDERS], spread[MAX_ORDERS][COLUMNS];
} Piece;

/* Fit a segment by a polynomial of COLUMNS coefficients, and differentiate that of its best degree. */
static void
differentiate_segment(const Stencils *by, const Samples *s, const Division *d, int part,
                      const Segment *segment, Piece *out)
{
    double factor[COLUMNS][COLUMNS] = {{0.0}}, along[COLUMNS][3] = {{0.0}}, squares[3] = {0.0};
    double of_degree[COLUMNS] = {0.0}, left = 0.0;
    long long length = d->present[segment->end] - d->present[segment->first];
    double unit = segment->end - segment->first;
    for (long long t = segment->first; t < segment->end; t++) {
        double row[COLUMNS], x[3], time = (t - by->at) / unit;
        for (int k = 0; k < COLUMNS; k++)
            row[k] = k ? row[k - 1] * time : d->root[t];
        for (int c = 0; c < 3; c++)
            x[c] = d->root[t] * s->x[c][t];
        for (int k = 0; k < COLUMNS; k++) {
            double cosine, sine;
            find_rotation(factor[k][k], row[k], &cosine, &sine);
            for (int l = k; l < COLUMNS; l++)
                rotate(cosine, sine, &factor[k][l], row + l);
            for (int c = 0; c < 3; c++)
                rotate(cosine, sine, &along[k][c], x + c);
        }
        for (int c = 0; c < 3; c++)
            squares[c] += x[c] * x[c];
    }
    for (int c = part; c <= 2 * part; c++) {
        left += squares[c];
        for (int k = 0; k < COLUMNS; k++)
            of_degree[k] += along[k][c] * along[k][c], left += k > DEGREE ? along[k][c] * along[k][c] : 0.0;
    }
    *out = (Piece){.degree = 0};
    best_degree(part, length, left, of_degree, &out->degree);
    for (int o = 0; o < by->orders; o++) {
        /* The derivative of this order of the powers of time is not zero for one of them only. */
        double of_power = tgamma(o + 1) * pow(unit, -o), basis[COLUMNS];
        out->highest[o] = out->degree + MORE_DEGREES > o ? out->degree + MORE_DEGREES : o;
        for (int k = 0; k < COLUMNS; k++) {
            basis[k] = k == o ? of_power : 0.0;
            for (int l = 0; l < k; l++)
                basis[k] -= factor[l][k] * basis[l];
            basis[k] = k < length ? basis[k] / factor[k][k] : 0.0;
            out->spread[o][k] = k <= out->highest[o] ? basis[k] : 0.0;
            for (int c = part; c <= (k <= out->degree ? 2 * part : -1); c++)
                out->mean[c][o] += basis[k] * along[k][c];
        }
    }
}

/* The result of several segments: means (3, orders), covariance, and effective number of parameters. */
typedef struct {
    double mean[3][MAX_ORDERS], covariance[MAX_ORDERS][MAX_ORDERS], freedom;
} Average;

/* Average the best segments of one part by their evidence, and its square root in the covariance. A segment that is
   too short to show a derivative has the `unknown` variance of it. Returns the log evidence of the best. */
static double
average_segments(const Stencils *by, const Samples *s, const Division *d, int part,
                 const double (*unknown)[MAX_ORDERS], Average *out)
{
    Segment kept[MAX_KEPT];
    Piece piece[MAX_KEPT];
    int number = keep_segments(d, part, by->at, kept);
    double total = 0.0, root_total = 0.0;
    memset(out, 0, sizeof *out);
    for (int k = 0; k < number; k++)
        total += exp(kept[k].value - kept->value), root_total += exp((kept[k].value - kept->value) / 2);
    for (int k = 0; k < number; k++) {
        double probability = exp(kept[k].value - kept->value) / total;
        differentiate_segment(by, s, d, part, kept + k, piece + k);
        out->freedom += probability * (piece[k].degree + 1);
        for (int c = part; c <= 2 * part; c++)
            for (int o = 0; o < by->orders; o++)
                out->mean[c][o] += probability * piece[k].mean[c][o];
    }
    for (int k = 0; k < number; k++) {
        double weight = exp((kept[k].value - kept->value) / 2) / root_total;
        long long length = d->present[kept[k].end] - d->present[kept[k].first];
        for (int o = 0; o < by->orders; o++) {
            if (piece[k].highest[o] >= length)
                out->covariance[o][o] += weight * unknown[o][o];
            for (int p = 0; p <= o; p++) {
                double sum = dot(piece[k].spread[o], piece[k].spread[p], COLUMNS);
                for (int c = part; c <= 2 * part; c++)
                    sum += (piece[k].mean[c][o] - out->mean[c][o]) *
                        (piece[k].mean[c][p] - out->mean[c][p]) / (part + 1);
                out->covariance[o][p] += weight * sum;
            }
        }
    }
    return number ? kept->value : -INFINITY;
}

/* Mix a result of segments into that of the models, by a probability in the mean and a weight in the covariance. */
static void
mix(const Average *segments, int part, long long orders, double probability, double weight,
    Estimate *estimate)
{
    /* The squares of the differences of both from their mean, over that of each other. */
    double by = (1 - weight) * probability * probability +
        weight * (1 - probability) * (1 - probability);
    for (int o = 0; o < orders; o++)
        for (int p = 0; p <= o; p++) {
            double *sum = &estimate->covariance[part][o][p];
            *sum += weight * (segments->covariance[o][p] - *sum);
            for (int c = part; c <= 2 * part; c++)
                *sum += by * (segments->mean[c][o] - estimate->mean[c][o]) *
                    (segments->mean[c][p] - estimate->mean[c][p]) / (part + 1);
            estimate->covariance[part][p][o] = *sum;
        }
    for (int c = part; c <= 2 * part; c++)
        for (int o = 0; o < orders; o++)
            estimate->mean[c][o] += probability * (segments->mean[c][o] - estimate->mean[c][o]);
    if (!part)
        estimate->freedom += probability * (segments->freedom - estimate->freedom);
}

PRIVATE int
add_segments(Call *call, const Stencils *by, const Samples *s, Estimate *estimate)
{
    Division d;
    if (evaluate_segments(call, s, &d))
        return NO_MEMORY;
    for (int part = 0; part < 2; part++) {
        Average segments;
        divide(&d, part);
        double value = average_segments(by, s, &d, part, estimate->covariance[part], &segments);
        /* Noise alone leaves a square of 1 a sample, which has no evidence in the models. */
        double ahead = value + d.present[d.count] * (part + 1) / 2.0 - estimate->evidence[part];
        mix(&segments, part, by->orders, 1 / (1 + exp(-ahead)), 1 / (1 + exp(-ahead / 2)), estimate);
    }
    return DONE;
}
