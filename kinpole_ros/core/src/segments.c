#include <math.h>
#include <string.h>

#include "segments.h"
#include "memory.h"
#include "numbers.h"
#include "polynomials.h"

/* Highest degree in a segment: that of free flight. */
#define DEGREE 2
#define COLUMNS MAX_ORDERS
/* Samples that are not missing of the shortest segment. */
#define MIN_LENGTH 2
/* Segments around the instant that count, and the log evidence by which others may be behind the
   best, and all of them behind the models. */
#define MAX_KEPT 8
#define MAX_BEHIND 20.0

/* All segments of a window. Part 0 is the angle, part 1 the position. */
typedef struct {
    long long count;    /* samples */
    double *root;       /* (count): of the smaller weight of each sample */
    double *present;    /* (count + 1): how many samples before each one are not missing */
    double *value[2];   /* (count, count): log evidence, by length less one and first sample */
    double *before[2];  /* (count + 1): the best log evidence of the samples before each one */
    double *after[2];   /* (count + 1): that of the samples from each one on */
    double excess[2];   /* log size of the samples, over COEFFICIENT_COST, if this is more */
    double *scratch;    /* at least (COLUMNS + 3, count) */
} Division;

/* The polynomials of all segments of one length; all arrays (count) are by their first sample. */
typedef struct {
    double *factor[DEGREE + 1][DEGREE + 1]; /* the triangular factor of the powers of time */
    double *along[DEGREE + 1][3];           /* orthonormal coefficients of the signals */
    double *squares[3];                     /* what the highest degree leaves of the signals */
    double *row[DEGREE + 1], *cosine[DEGREE + 1], *sine[DEGREE + 1]; /* of the last sample */
} Fits;

/* Rotate the numbers `own` and `other`, in place, by an angle with this cosine and sine
   (Givens). */
static inline void
rotate(double cosine, double sine, double *own, double *other)
{
    double old = *own;
    *own = cosine * old + sine * *other;
    *other = cosine * *other - sine * old;
}

/* Rotate one more sample, the one `last` after the first, into the triangular factors of all
   segments that it extends. There are `distinct` factors: one if all samples count alike, or one
   for each segment. */
static void
extend_factors(const Division *d, long long distinct, long long last, Fits *f)
{
    double time = last / (double)d->count;
    for (long long i = 0; i < distinct; i++)
        for (int k = 0; k <= DEGREE; k++)
            f->row[k][i] = k ? f->row[k - 1][i] * time : d->root[i + last];
    for (int k = 0; k <= DEGREE; k++)
        for (long long i = 0; i < distinct; i++) {
            double own = f->factor[k][k][i], other = f->row[k][i];
            double size = sqrt(own * own + other * other);
            f->cosine[k][i] = size > 0.0 ? own / size : 1.0;
            f->sine[k][i] = size > 0.0 ? other / size : 0.0;
            for (int l = k; l <= DEGREE; l++)
                rotate(f->cosine[k][i], f->sine[k][i], f->factor[k][l] + i, f->row[l] + i);
        }
}

/* Rotate the sample into the coefficients of signal `c` of so many `segments`, whose factors are as
   `distinct` as in `extend_factors`: the one of segment i is sample[i], with the root[i] of its
   weight. What is left adds to the squares of the segment. */
static void
extend_signal(const double *restrict sample, const double *restrict root, long long segments,
              long long distinct, const Fits *f, int c)
{
    double *restrict along[DEGREE + 1], *restrict squares = f->squares[c];
    for (int k = 0; k <= DEGREE; k++)
        along[k] = f->along[k][c];
    if (distinct == 1) {
        double cosine[DEGREE + 1], sine[DEGREE + 1];
        for (int k = 0; k <= DEGREE; k++)
            cosine[k] = f->cosine[k][0], sine[k] = f->sine[k][0];
        for (long long i = 0; i < segments; i++) {
            double x = root[i] * sample[i];
            for (int k = 0; k <= DEGREE; k++)
                rotate(cosine[k], sine[k], along[k] + i, &x);
            squares[i] += x * x;
        }
        return;
    }
    for (long long i = 0; i < segments; i++) {
        double x = root[i] * sample[i];
        for (int k = 0; k <= DEGREE; k++)
            rotate(f->cosine[k][i], f->sine[k][i], along[k] + i, &x);
        squares[i] += x * x;
    }
}

/* Find the log `evidence` of a segment by its degree, from the `squares` that the highest degree
   leaves and those of each coefficient, `of_degree`, both summed over the signals of a part. */
static inline void
evidence_of_degrees(int part, double squares, const double *of_degree, double *evidence)
{
    double cost = COEFFICIENT_COST * (part + 1);
    evidence[DEGREE] = -squares / 2 - (DEGREE + 1) * cost - EVENT_COST;
    for (int k = DEGREE; k > 0; k--)
        evidence[k - 1] = evidence[k] + cost - of_degree[k] / 2;
}

/* Bound the degree of a segment: it has no more coefficients than its `length`, the samples that
   are not missing. Where it has as many, nothing but their cost bounds them, so each costs `excess`
   more. */
static inline void
bound_degree(double length, double excess, double *evidence)
{
    for (int k = 0; k <= DEGREE; k++) {
        evidence[k] -= k + 1 == length ? (k + 1) * excess : 0.0;
        evidence[k] = length < MIN_LENGTH || k >= length ? -INFINITY : evidence[k];
    }
}

/* Find the log `evidence` of segment `i` of one length by its degree, from the coefficients `z` of
   the signals of a part and the `squares` that are left. */
static inline void
evidence_of_segment(const double *restrict z[][2], const double *restrict *squares, int part,
                    long long i, double *evidence)
{
    double of_degree[DEGREE + 1];
    for (int k = 0; k <= DEGREE; k++)
        of_degree[k] = z[k][0][i] * z[k][0][i] + part * (z[k][1][i] * z[k][1][i]);
    evidence_of_degrees(part, squares[0][i] + part * squares[1][i], of_degree, evidence);
}

/* Return the evidence of the best degree. */
static inline double
best_degree(const double *evidence)
{
    double best = evidence[0];
    for (int k = 1; k <= DEGREE; k++)
        best = larger(best, evidence[k]);
    return best;
}

/* Find the log evidence of all segments of length `last` + 1 of a part, 0 for the angle, 1 for the
   position, and write it to the `value` of the division. */
static void
find_values(const Division *d, int part, long long last, const Fits *f)
{
    double *restrict value = d->value[part] + last * d->count;
    const double *restrict z[DEGREE + 1][2], *restrict squares[2];
    const double *restrict present = d->present, *restrict end = d->present + last + 1;
    for (int j = 0; j < 2; j++) {
        squares[j] = f->squares[part + part * j];
        for (int k = 0; k <= DEGREE; k++)
            z[k][j] = f->along[k][part + part * j];
    }
    long long segments = d->count - last;
    int has_few = last <= DEGREE || d->present[d->count] < d->count;
    for (long long i = 0; i < segments; i++) {
        double evidence[DEGREE + 1];
        evidence_of_segment(z, squares, part, i, evidence);
        value[i] = best_degree(evidence);
    }
    /* Apart, so that the loop above has no branches: those of few samples. */
    for (long long i = 0; i < (has_few ? segments : 0); i++)
        if (end[i] - present[i] <= DEGREE + 1) {
            double evidence[DEGREE + 1];
            evidence_of_segment(z, squares, part, i, evidence);
            bound_degree(end[i] - present[i], d->excess[part], evidence);
            value[i] = best_degree(evidence);
        }
}

/* Lay out the arrays of a division, and find the evidence of the segments of a window. Returns DONE
   or NO_MEMORY. */
static int
evaluate_segments(Call *call, const Samples *s, Division *d)
{
    long long n = s->count;
    int is_even = 1;
    size_t of_fits = (DEGREE + 1) * (DEGREE + 1 + 3 + 3) + 3;
    size_t size = ((of_fits + 6 + 2 * n) * n + 5) * sizeof(double);
    char *data = kinpole_buffer(call, OF_SEGMENTS, size);
    Fits f;
    if (!data)
        return NO_MEMORY;
    memset(data, 0, of_fits * n * sizeof(double));
    d->scratch = (double *)data; /* free when all are evaluated */
    for (int k = 0; k <= DEGREE; k++) {
        TAKE(f.row[k], n), TAKE(f.cosine[k], n), TAKE(f.sine[k], n);
        for (int l = 0; l <= DEGREE; l++)
            TAKE(f.factor[k][l], n);
        for (int c = 0; c < 3; c++)
            TAKE(f.along[k][c], n);
    }
    for (int c = 0; c < 3; c++)
        TAKE(f.squares[c], n);
    TAKE(d->root, n), TAKE(d->present, n + 1);
    for (int part = 0; part < 2; part++)
        TAKE(d->value[part], n * n), TAKE(d->before[part], n + 1), TAKE(d->after[part], n + 1);
    d->count = n, d->present[0] = 0;
    for (long long t = 0; t < n; t++) {
        d->root[t] = sqrt(smaller(s->weight[0][t], s->weight[1][t]));
        d->present[t + 1] = d->present[t] + (d->root[t] > 0.0);
        is_even &= d->root[t] == 1.0;
    }
    for (int part = 0; part < 2; part++) {
        double square = 0.0, number = n * (part + 1);
        for (int c = part; c <= 2 * part; c++)
            for (long long t = 0; t < n; t++)
                square += d->root[t] * d->root[t] * s->x[c][t] * s->x[c][t];
        d->excess[part] = (part + 1) * larger(log(square / number) / 2 - COEFFICIENT_COST, 0.0);
    }
    for (long long last = 0; last < n; last++) {
        long long distinct = is_even ? 1 : n - last;
        extend_factors(d, distinct, last, &f);
        for (int c = 0; c < 3; c++)
            extend_signal(s->x[c] + last, d->root + last, n - last, distinct, &f, c);
        find_values(d, 0, last, &f), find_values(d, 1, last, &f);
    }
    /* There is an event: without one the models have more to say. */
    for (int part = 0; part < 2; part++)
        d->value[part][(n - 1) * n] = -INFINITY;
    return DONE;
}

/* Find the best log evidence of the samples of a part before each one, in `before`. The first
   segment is not after an event, and its mean and slope cost nothing, as those of the models.
   Returns the log evidence of all, over that of noise alone, which leaves 1 a sample of squares. */
static double
divide_before(const Division *d, int part)
{
    long long n = d->count;
    double *before = d->before[part];
    before[0] = EVENT_COST + 2 * COEFFICIENT_COST * (part + 1);
    for (long long end = 1; end <= n; end++)
        before[end] = -INFINITY;
    for (long long first = 0; first < n; first++)
        for (long long last = 0; last < n - first; last++)
            before[first + last + 1] = larger(
                before[first + last + 1], before[first] + d->value[part][last * n + first]);
    return before[n] + d->present[n] * (part + 1) / 2;
}

/* Find the best log evidence of the samples of a part from each one on, in `after`. */
static void
divide_after(const Division *d, int part)
{
    long long n = d->count;
    double *after = d->after[part];
    after[n] = 0.0;
    for (long long first = 0; first < n; first++)
        after[first] = -INFINITY;
    for (long long end = n; end > 0; end--)
        for (long long last = 0; last < end; last++)
            after[end - 1 - last] = larger(
                after[end - 1 - last],
                after[end] + d->value[part][last * n + end - 1 - last]);
}

/* Samples from `first` to before `end`. */
typedef struct {
    long long first, end;
    double value; /* log evidence of the best division that has them as a segment */
} Segment;

/* Return whether a segment may begin at a sample: one that is missing is in the segment before. */
static inline int
begins_segment(const Division *d, long long sample)
{
    return sample == 0 || sample == d->count || d->root[sample] > 0.0;
}

/* Find the best segments around the instant `at`, samples after the first, of a part, from the best
   log evidence `before` and `after` each sample. Writes `kept`, at most MAX_KEPT, the best first;
   returns how many. */
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
            if (!(value > least) || !begins_segment(d, first) || !begins_segment(d, end))
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

/* The derivatives of a segment at the instant, of one part. */
typedef struct {
    int degree;                           /* the likeliest */
    int highest[MAX_ORDERS];              /* degree that an order has for its deviation */
    double mean[3][MAX_ORDERS];
    double deviation[MAX_ORDERS][COLUMNS]; /* by coefficient: covariances are products of these */
} Piece;

/* Fit a segment of a part by a polynomial of COLUMNS coefficients, and differentiate that of its
   best degree. The powers of time, of which each is made orthonormal to those before it, and the
   signals are at `scratch` (COLUMNS + 3, n). Writes `out`. */
static void
differentiate_segment(const Stencils *stencils, const Samples *s, const Division *d, int part,
                      const Segment *segment, double *scratch, Piece *out)
{
    double of_degree[COLUMNS] = {0.0}, left = 0.0, evidence[DEGREE + 1];
    double derivatives[MAX_ORDERS][MAX_POLYNOMIALS], *root = d->root + segment->first;
    long long n = segment->end - segment->first, first = segment->first;
    Polynomials p = {.count = COLUMNS, .length = d->present[segment->end] - d->present[first]};
    for (long long t = 0; t < n; t++) {
        scratch[t] = root[t];
        for (int j = 0; j <= part; j++)
            scratch[(COLUMNS + j) * n + t] = root[t] * s->x[part + j][first + t];
    }
    make_polynomials(scratch, n, first - stencils->at, &p);
    fit_polynomials(scratch, n, scratch + COLUMNS * n, part + 1, &p);
    differentiate_polynomials(&p, n, stencils->orders, derivatives);
    for (int j = 0; j <= part; j++) {
        left += p.left[j];
        for (int k = 0; k < COLUMNS; k++) {
            of_degree[k] += p.along[k][j] * p.along[k][j];
            left += k > DEGREE ? p.along[k][j] * p.along[k][j] : 0.0;
        }
    }
    *out = (Piece){.degree = 0};
    evidence_of_degrees(part, left, of_degree, evidence);
    bound_degree(p.length, d->excess[part], evidence);
    for (int k = 1; k <= DEGREE; k++)
        out->degree = evidence[k] > evidence[out->degree] ? k : out->degree;
    for (int o = 0; o < stencils->orders; o++) {
        out->highest[o] = out->degree + MORE_DEGREES > o ? out->degree + MORE_DEGREES : o;
        for (int k = 0; k <= out->highest[o] && k < COLUMNS; k++)
            out->deviation[o][k] = derivatives[o][k];
        for (int k = 0; k <= out->degree; k++)
            for (int j = 0; j <= part; j++)
                out->mean[part + j][o] += derivatives[o][k] * p.along[k][j];
    }
}

/* The result of several segments, of one part. */
typedef struct {
    double mean[3][MAX_ORDERS];                /* derivatives at the instant */
    double covariance[MAX_ORDERS][MAX_ORDERS]; /* the lower triangle */
    double parameters;                         /* effective number */
} Average;

/* Average the best segments of a part, into `out`, by their evidence, and by a power of it in the
   covariance. Where a segment is too short to show a derivative, it is that of the `models`, or
   another. Returns how many segments there are. */
static int
average_segments(const Stencils *stencils, const Samples *s, const Division *d, int part,
                 const Estimate *models, Average *out)
{
    Segment kept[MAX_KEPT];
    Piece piece[MAX_KEPT];
    int number = keep_segments(d, part, stencils->at, kept);
    double total = 0.0, power_total = 0.0;
    *out = (Average){.parameters = 0.0};
    for (int k = 0; k < number; k++)
        total += exp(kept[k].value - kept->value),
            power_total += exp(PLACE_POWER * (kept[k].value - kept->value));
    for (int k = 0; k < number; k++) {
        double probability = exp(kept[k].value - kept->value) / total;
        differentiate_segment(stencils, s, d, part, kept + k, d->scratch, piece + k);
        out->parameters += probability * (piece[k].degree + 1);
        for (int c = part; c <= 2 * part; c++)
            for (int o = 0; o < stencils->orders; o++)
                out->mean[c][o] += probability * piece[k].mean[c][o];
    }
    for (int k = 0; k < number; k++) {
        double weight = exp(PLACE_POWER * (kept[k].value - kept->value)) / power_total;
        double length = d->present[kept[k].end] - d->present[kept[k].first];
        for (int o = 0; o < stencils->orders; o++) {
            for (int c = part; c <= (piece[k].highest[o] < length ? -1 : 2 * part); c++) {
                double off = models->mean[c][o] - piece[k].mean[c][o];
                out->covariance[o][o] +=
                    weight * (models->covariance[part][o][o] + off * off) / (part + 1);
            }
            for (int p = 0; p <= o; p++) {
                double sum = dot(piece[k].deviation[o], piece[k].deviation[p], COLUMNS);
                for (int c = part; c <= 2 * part; c++)
                    sum += (piece[k].mean[c][o] - out->mean[c][o]) *
                        (piece[k].mean[c][p] - out->mean[c][p]) / (part + 1);
                out->covariance[o][p] += weight * sum;
            }
        }
    }
    return number;
}

/* Mix a result of segments into that of the models, `estimate`, of a part: by the probability of
   the segments in the mean, and by their weight in the covariance. */
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
        estimate->parameters += probability * (segments->parameters - estimate->parameters);
    estimate->event[part] += probability * (1 - estimate->event[part]);
}

PRIVATE int
add_segments(Call *call, const Stencils *stencils, const Samples *s, Estimate *estimate)
{
    Division d;
    if (evaluate_segments(call, s, &d))
        return NO_MEMORY;
    for (int part = 0; part < 2; part++) {
        Average segments;
        double evidence = divide_before(&d, part), ahead = evidence - estimate->evidence[part];
        if (!(ahead > -MAX_BEHIND))
            continue;
        divide_after(&d, part);
        if (average_segments(stencils, s, &d, part, estimate, &segments))
            mix(&segments, part, stencils->orders, 1 / (1 + exp(-ahead)),
                1 / (1 + exp(-ahead / 2)), estimate);
        estimate->evidence[part] = larger(estimate->evidence[part], evidence);
    }
    return DONE;
}
