/*
 * Polynomials with steps of their derivatives, by evidence: which events are reported.
 *
 * Within a window a signal is a polynomial and white noise. An event adds multiples of (t - p)^k /
 * k! after its place p, of one or two orders k. Each coefficient costs about the logarithm of how
 * far it exceeds its noise (the evidence of a Gaussian prior as wide as the estimate). Angle and
 * position have evidence of their own. An event is reported for its log odds against all else:
 * polynomials without steps, of higher degrees too, and steps that are no events. Windows of
 * several lengths are searched, the shortest first: it is simple and has the time best, but sees
 * little.
 *
 * Polynomials are orthonormal on the samples, so steps need no columns: their products with
 * polynomials, with samples and with each other are sums over the samples after the place, which a
 * place takes over from the next later one (`sum_after`).
 *
 * Times and places are in intervals between samples, signals in deviations of their noise. Signal
 * c = 0 is the angle, 1 and 2 are the coordinates of the position. Part 0 is the angle, part 1 the
 * position, with the signals from `part` to 2 * `part`. Columns are the steps of a set.
 */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../include/change_points.h"
#include "numbers.h"

/* Samples after the event in the shortest window, and lengths, each half of the one before. */
#define SHORTEST 8
#define MAX_WINDOWS 16
/* Degrees at most of polynomials with steps and without, one for two samples: what these do not
   explain shall not be explained by a step. */
#define STEP_DEGREE 8
#define MAX_DEGREE 24
/* Samples that the noise is known from beforehand. */
#define PRIOR_SAMPLES 30.0
/* What a coefficient costs besides the logarithm of how far it exceeds its noise. */
#define COST 1.0
/* Log odds that an event must have against all else: found and false events over hours. */
#define ENOUGH 18.0
/* An event of order 2 or 3 is less distinct from smooth motion: signals of at most this degree must
   show it, too. */
#define SIMPLE_DEGREE 4
/* Places of a window that are tried at first, about. */
#define MAX_PLACES 32
/* Log evidence below the best that does not matter. */
#define NEGLIGIBLE 20.0
/* Squares below this share of a step's own are rounding. */
#define ROUNDING 1e-9
/* Places at once around an event that is refined, and rounds of it. */
#define REFINED 9
#define ROUNDS 6

/* Orders of steps, and of events, at most. */
#define MOST_ORDER 5
#define MOST_EVENT 3
/* Orders of a set of steps at most. */
#define PAIR 2

/* Orders that step together: the first is the event, another may step with it. */
typedef struct {
    int count, order[PAIR];
} Orders;

/* Events, and from EVENTS on what looks like one: poses that jump, and motion that sets in
   gradually. */
#define EVENTS 5
#define SETS 7
static const Orders sets[SETS] = {{1, {1}}, {2, {1, 2}}, {1, {2}}, {2, {2, 3}}, {1, {3}},
                                  {1, {0}}, {2, {4, 5}}};

/* Polynomials on the samples of a window, and how well they explain these. */
typedef struct {
    long long count;                          /* samples */
    int highest, simplest;                    /* degree of polynomials without and with steps */
    const double *time, *values[3];           /* (count), of the window */
    double *basis;                            /* (highest + 1, count): the polynomials */
    double along[MAX_DEGREE + 1][3];          /* coefficients of the signals */
    double squares[2][STEP_DEGREE + 1];       /* sum of squares that is left, by part and degree */
    double value[2][STEP_DEGREE + 1];         /* log evidence, over that of all degrees together */
    double number[2];                         /* half of the samples of a part, with the prior */
} Fit;

enum { SUMS = STEP_DEGREE + 1 + 3 };

/* Sums over the samples after a place, with (t - place)^k / k! for each order k: of the
   polynomials, then of the signals; and of the powers alone. */
typedef struct {
    double sums[MOST_ORDER + 1][SUMS], powers[2 * MOST_ORDER + 1];
} After;

/* Columns that are added to polynomials, by their products. */
typedef struct {
    int count;
    double own[PAIR][PAIR];              /* with each other */
    double along[STEP_DEGREE + 1][PAIR]; /* with the polynomials */
    double product[3][PAIR];             /* with the signals */
} Added;

/* Make the polynomials of degrees up to `highest`, orthonormal on the samples, in `basis`, by their
   recurrence. Its rounding grows from a degree of about the root of twice the samples on;
   these are made orthogonal once more. */
static void
find_basis(Fit *f)
{
    long long n = f->count;
    double middle = (f->time[0] + f->time[n - 1]) / 2, half = (f->time[n - 1] - f->time[0]) / 2;
    for (int d = 0; d <= f->highest; d++) {
        double *own = f->basis + d * n;
        const double *before = own - n;
        for (long long t = 0; t < n; t++)
            own[t] = d ? before[t] * (f->time[t] - middle) / half : 1.0;
        for (int round = 0; round < (d * d > 2 * n ? 2 : 1); round++)
            for (int e = round || d < 2 ? 0 : d - 2; e < d; e++) {
                const double *other = f->basis + e * n;
                double by = dot(own, other, n);
                for (long long t = 0; t < n; t++)
                    own[t] -= by * other[t];
            }
        double size = 1 / sqrt(dot(own, own, n));
        for (long long t = 0; t < n; t++)
            own[t] *= size;
    }
}

/* Return the logarithm of the sum of exp(values) (count), without overflow. */
static double
log_of_sum(const double *values, int count)
{
    double most = values[0], sum = 0.0;
    for (int k = 1; k < count; k++)
        most = larger(most, values[k]);
    for (int k = 0; k < count; k++)
        sum += exp(values[k] - most);
    return most + log(sum);
}

/* Fit the signals of a window by its polynomials: writes `along`, `squares`, `value` and `number`
   of `f`, from its other fields. `white` is 1 for curves without noise, whose squares get those of
   unit noise. */
static void
fit_signals(Fit *f, int white)
{
    for (int d = 0; d <= f->highest; d++)
        for (int c = 0; c < 3; c++)
            f->along[d][c] = dot(f->basis + d * f->count, f->values[c], f->count);
    for (int part = 0; part < 2; part++) {
        double value[MAX_DEGREE + 1] = {0.0}, squares[MAX_DEGREE + 1] = {0.0}, cost = 0.0;
        f->number[part] = (PRIOR_SAMPLES + (part + 1) * f->count) / 2;
        for (int d = 0; d <= f->highest; d++) {
            for (int c = part; c <= 2 * part; c++)
                cost += log1p(f->along[d][c] * f->along[d][c]) / 2 + COST;
            value[d] = -cost;
        }
        for (int c = part; c <= 2 * part; c++) {
            double left = dot(f->values[c], f->values[c], f->count);
            for (int d = 0; d <= f->highest; d++) {
                left -= f->along[d][c] * f->along[d][c];
                squares[d] += larger(left, 0.0) + (white ? f->count - 1 - d : 0);
            }
        }
        for (int d = 0; d <= f->highest; d++)
            value[d] -= f->number[part] * log(PRIOR_SAMPLES + squares[d]);
        double smooth = log_of_sum(value + 1, f->highest);
        for (int d = 0; d <= f->simplest; d++)
            f->squares[part][d] = squares[d], f->value[part][d] = value[d] - smooth;
    }
}

/* Fit the window that goes on until `after` intervals after time 0, of samples `time` (count) and
   `values` (3, count). Writes `f`, and its basis to `memory` (MAX_DEGREE + 1, count). Returns 1, or
   0 if there are too few samples. */
static int
fit_window(const double *time, const double *values, long long count, long long after,
           double *memory, Fit *f)
{
    long long first = 0, last = count, before = 0;
    while (first < last && time[first] < -TIMES_BEFORE * after - 0.1)
        first++;
    while (last > first && time[last - 1] >= after + 0.1)
        last--;
    while (first + before < last && time[first + before] < 0)
        before++;
    long long n = last - first;
    if (before < SHORTEST || n - before < SHORTEST - 2)
        return 0;
    *f = (Fit){.count = n, .time = time + first, .basis = memory};
    f->highest = n / 2 < MAX_DEGREE ? n / 2 : MAX_DEGREE;
    f->simplest = f->highest < STEP_DEGREE ? f->highest : STEP_DEGREE;
    for (int c = 0; c < 3; c++)
        f->values[c] = values + c * count + first;
    find_basis(f);
    fit_signals(f, 0);
    return 1;
}

/* Find the sums `out` (number) after `places` (number), which rise, with the orders up to
   `highest`; those of higher orders are 0. Sums move to a place by h earlier with (t - p + h)^k /
   k! = sum of (t - p)^(k - j) / (k - j)! h^j / j!. */
static void
sum_after(const Fit *f, const double *places, int number, int highest, After *out)
{
    After now = {{{0.0}}, {0.0}};
    long long t = f->count;
    double last = f->time[f->count - 1];
    for (int place = number - 1; place >= 0; place--) {
        double by = last - places[place], power[2 * MOST_ORDER + 1] = {1.0};
        for (int k = 1; k <= 2 * highest; k++)
            power[k] = power[k - 1] * by / k;
        for (int k = 2 * highest; k > 0; k--)
            for (int j = 1; j <= k; j++) {
                now.powers[k] += power[j] * now.powers[k - j];
                for (int i = 0; i < (k <= highest ? SUMS : 0); i++)
                    now.sums[k][i] += power[j] * now.sums[k - j][i];
            }
        for (last = places[place]; t > 0 && f->time[t - 1] > last; t--) {
            double since = f->time[t - 1] - last, value[SUMS], of_power = 1.0;
            for (int d = 0; d <= STEP_DEGREE; d++)
                value[d] = d <= f->simplest ? f->basis[d * f->count + t - 1] : 0.0;
            for (int c = 0; c < 3; c++)
                value[STEP_DEGREE + 1 + c] = f->values[c][t - 1];
            for (int k = 0; k <= 2 * highest; k++, of_power *= since / k) {
                now.powers[k] += of_power;
                for (int i = 0; i < (k <= highest ? SUMS : 0); i++)
                    now.sums[k][i] += of_power * value[i];
            }
        }
        out[place] = now;
    }
}

/* Return the products of the steps of a set at a place, from the sums `after` it. */
static Added
steps_of(const Orders *set, const After *after)
{
    Added steps = {.count = set->count};
    for (int k = 0; k < set->count; k++) {
        const double *sums = after->sums[set->order[k]];
        for (int l = 0; l <= k; l++) {
            /* Powers j and k over their factorials are one power times a binomial. */
            double binomial = 1.0;
            for (int j = 1; j <= set->order[l]; j++)
                binomial *= (set->order[k] + j) / (double)j;
            steps.own[k][l] = steps.own[l][k] =
                binomial * after->powers[set->order[k] + set->order[l]];
        }
        for (int d = 0; d <= STEP_DEGREE; d++)
            steps.along[d][k] = sums[d];
        for (int c = 0; c < 3; c++)
            steps.product[c][k] = sums[STEP_DEGREE + 1 + c];
    }
    return steps;
}

/* What polynomials leave of columns, each without those before it. */
typedef struct {
    double inverse[PAIR];  /* one over the square of each; 0 if it is rounding */
    double value[PAIR][3]; /* their products with the signals */
} Reduced;

/* Return what polynomials leave of the columns `added`, whose products without the polynomials are
   `left`. */
static Reduced
reduce(const Added *added, const Added *left)
{
    Reduced out = {{0.0}, {{0.0}}};
    for (int k = 0; k < added->count; k++) {
        double shared = k ? left->own[1][0] * out.inverse[0] : 0.0;
        double own = left->own[k][k] - shared * left->own[0][k];
        if (own > ROUNDING * added->own[k][k])
            out.inverse[k] = 1 / own;
        for (int c = 0; c < 3; c++)
            out.value[k][c] = left->product[c][k] - shared * out.value[0][c];
    }
    return out;
}

/* Subtract from the products `left` of columns what they have along the polynomial of a `degree` up
   to STEP_DEGREE. `along` stays. */
static void
subtract_degree(const Fit *f, int degree, Added *left)
{
    const double *along = left->along[degree];
    for (int k = 0; k < left->count; k++) {
        for (int l = 0; l < left->count; l++)
            left->own[k][l] -= along[k] * along[l];
        for (int c = 0; c < 3; c++)
            left->product[c][k] -= along[k] * f->along[degree][c];
    }
}

/* Return the log evidence that the columns `added` bring to the angle and to the position, each of
   which may be without, over that of all degrees together. Writes how much of it each part has,
   `gain` (2), and its likeliest `degree` (2), 1 or more. Degrees that cannot matter are left at
   less than their evidence. */
static double
gain_of(const Fit *f, const Added *added, double *gain, int *degree)
{
    /* Those of degree 0 stand for no columns. */
    double value[2][STEP_DEGREE + 1] = {{0.0}}, most[2] = {0.0};
    Added left = *added;
    subtract_degree(f, 0, &left);
    degree[0] = degree[1] = 1;
    for (int d = 1; d <= f->simplest; d++) {
        subtract_degree(f, d, &left);
        Reduced reduced = reduce(added, &left);
        for (int part = 0; part < 2; part++) {
            double signals = part + 1, explained = 0.0, square[PAIR] = {0.0};
            for (int k = 0; k < added->count; k++) {
                for (int c = part; c <= 2 * part; c++)
                    square[k] += reduced.value[k][c] * reduced.value[k][c];
                square[k] *= reduced.inverse[k], explained += square[k];
            }
            double all = PRIOR_SAMPLES + f->squares[part][d], *own = value[part] + d;
            double z = smaller(explained, f->squares[part][d]) / all;
            *own = f->value[part][d] - added->count * COST;
            /* A bound of -log(1 - z). */
            if (*own + f->number[part] * z * (2 - z) / (2 - 2 * z) > most[part] - NEGLIGIBLE)
                *own -= f->number[part] * log(1 - z) +
                    signals / 2 * log((1 + square[0] / signals) * (1 + square[1] / signals));
            most[part] = larger(most[part], *own);
            if (*own > value[part][degree[part]])
                degree[part] = d;
        }
    }
    for (int part = 0; part < 2; part++)
        gain[part] = log_of_sum(value[part], f->simplest + 1) - log(2);
    return gain[0] + gain[1];
}

/* Find the place of a set of steps near `place`, within some `step`, both intervals, and its
   standard deviation `sigma`, by moments of the evidence at places tried. Writes `place` and
   `sigma`; returns the log evidence. */
static double
refine(const Fit *f, const Orders *set, double step, double *place, double *sigma)
{
    After after[REFINED];
    double half = 3 * step, most = 0.0, parts[2];
    int degree[2];
    for (int round = 0; round < ROUNDS; round++) {
        double places[REFINED], gain[REFINED], sum = 0.0, mean = 0.0, square = 0.0;
        int number = 0;
        for (int k = 0; k < REFINED; k++) {
            double at = *place + half * (k / ((REFINED - 1) / 2.0) - 1);
            if (at > f->time[0] + 1 && at < f->time[f->count - 1] - 1)
                places[number++] = at;
        }
        sum_after(f, places, number, set->order[set->count - 1], after);
        most = -INFINITY;
        for (int k = 0; k < number; k++) {
            Added steps = steps_of(set, after + k);
            gain[k] = gain_of(f, &steps, parts, degree), most = larger(most, gain[k]);
        }
        for (int k = 0; k < number; k++)
            gain[k] = exp(gain[k] - most), sum += gain[k], mean += gain[k] * places[k];
        mean /= sum;
        for (int k = 0; k < number; k++)
            square += gain[k] / sum * (places[k] - mean) * (places[k] - mean);
        *place = mean, *sigma = sqrt(square);
        if (*sigma > half / 5 || half < 1e-3)
            break;
        half = larger(5 * *sigma, half / 8);
    }
    return most;
}

/* Estimate the sizes of the steps `added`, `size` by order and signal, with polynomials of the
   degrees `degree` (2), and the standard deviations `sigma` (3) of the first. Sizes that are
   rounding are 0, and so is the second where there is one step. */
static void
estimate_sizes(const Fit *f, const Added *added, const int *degree, double size[PAIR][3],
               double *sigma)
{
    for (int part = 0; part < 2; part++) {
        Added left = *added;
        for (int d = 0; d <= degree[part]; d++)
            subtract_degree(f, d, &left);
        Reduced reduced = reduce(added, &left);
        double shared = left.own[1][0] * reduced.inverse[0];
        for (int c = part; c <= 2 * part; c++) {
            size[1][c] = reduced.value[1][c] * reduced.inverse[1];
            size[0][c] = reduced.value[0][c] * reduced.inverse[0] - shared * size[1][c];
            sigma[c] = sqrt(reduced.inverse[0] + shared * shared * reduced.inverse[1]);
        }
    }
}

/* Places of a window that are tried. */
typedef struct {
    int number;
    double step;                  /* intervals from one place to the next */
    double place[2 * MAX_PLACES]; /* (number), rising */
    After after[2 * MAX_PLACES];  /* (number): sums after them */
} Places;

/* List places `p` from `first` to `last` and a step around, inside the window, and sum after them
   with the orders up to `highest`. There may be none. */
static void
list_places(const Fit *f, double first, double last, int highest, Places *p)
{
    p->step = ceil((f->time[f->count - 1] - f->time[0]) / MAX_PLACES);
    first = larger(first - p->step, f->time[0] + 1);
    last = smaller(last + p->step, f->time[f->count - 1] - 1);
    for (p->number = 0; first <= last && p->number < 2 * MAX_PLACES; first += p->step)
        p->place[p->number++] = first;
    sum_after(f, p->place, p->number, highest, p->after);
}

/* Return the log evidence of the best of the sets from `first` to before `last` at the places `p`,
   and its place in `place`; -infinity without places. */
static double
best_place(const Fit *f, int first, int last, const Places *p, double *place)
{
    double best = -INFINITY, parts[2];
    int degree[2];
    for (int k = first; k < last; k++)
        for (int i = 0; i < p->number; i++) {
            Added steps = steps_of(sets + k, p->after + i);
            double gain = gain_of(f, &steps, parts, degree);
            if (gain > best)
                best = gain, *place = p->place[i];
        }
    return best;
}

/* An event at a place. */
typedef struct {
    const Orders *set;    /* orders of its steps */
    Added steps;          /* their products at the place */
    double gain[2];       /* log evidence that angle and position have for it */
    int degree[2];        /* their likeliest degrees, */
    int more[2];          /* and one more, for the bias of the likeliest */
    double size[PAIR][3]; /* sizes of the steps with these, by signal */
} Hypothesis;

/* Find the best set of steps of an event near the place `near`, within some `step`, both intervals.
   Writes `best`, and describes it in `found`, with a gain of -infinity if none is finite. */
static void
find_order(const Fit *f, double near, double step, Hypothesis *best, ChangePoint *found)
{
    *found = (ChangePoint){.place = near, .gain = -INFINITY}, best->set = sets;
    for (int k = 0; k < EVENTS; k++) {
        ChangePoint one = {.place = near, .step_order = sets[k].order[0]};
        one.gain = refine(f, sets + k, step, &one.place, &one.place_sigma);
        if (one.gain > found->gain)
            *found = one, best->set = sets + k;
    }
    After after;
    sum_after(f, &found->place, 1, MOST_EVENT, &after);
    best->steps = steps_of(best->set, &after);
    gain_of(f, &best->steps, best->gain, best->degree);
    for (int part = 0; part < 2; part++)
        best->more[part] = best->degree[part] + (best->degree[part] < f->simplest);
    estimate_sizes(f, &best->steps, best->more, best->size, found->step_sigma);
    memcpy(found->step, best->size[0], sizeof found->step);
}

/* Whether a shorter window shows half of the evidence for an event at a `place` that the curve of
   the longer one `f`, polynomial and steps, has there with unit noise. `curve` is memory for
   (3, count) of the shorter one. */
static int
is_confirmed(const Fit *f, const Fit *shorter, const Hypothesis *event, double place, double *curve)
{
    if (!(place > shorter->time[0] + 3 && place < shorter->time[shorter->count - 1] - 3))
        return 1;
    double most[2] = {0.0}, gain[2];
    int degree[2];
    Fit expected = *shorter;
    for (int c = 0; c < 3; c++) {
        double *own = curve + c * expected.count;
        expected.values[c] = own;
        for (long long t = 0; t < expected.count; t++) {
            double since = expected.time[t] - place;
            long long row = expected.time + t - f->time;
            own[t] = 0.0;
            for (int d = 0; d <= event->more[c > 0]; d++) {
                double along = f->along[d][c];
                for (int k = 0; k < event->set->count; k++)
                    along -= event->size[k][c] * event->steps.along[d][k];
                own[t] += along * f->basis[d * f->count + row];
            }
            for (int k = 0; k < event->set->count && since > 0; k++)
                own[t] += event->size[k][c] * pow(since, event->set->order[k]) /
                    tgamma(event->set->order[k] + 1);
        }
    }
    fit_signals(&expected, 1);
    for (int which = 0; which < 2; which++) {
        const Fit *fit = which ? &expected : shorter;
        After after;
        sum_after(fit, &place, 1, MOST_EVENT, &after);
        for (int k = 0; k < EVENTS; k++) {
            Added steps = steps_of(sets + k, &after);
            most[which] = larger(most[which], gain_of(fit, &steps, gain, degree));
        }
    }
    return most[0] >= most[1] / 2;
}

/* Find an event in the window `f`, at most `radius` from `offset`, both intervals; as many as
   `shorter` windows are parts of it, the first of them f + 1. `p` and `scratch` (3, count) are
   memory. Writes `found`; returns whether there is one. */
static int
search_window(const Fit *f, int shorter, double offset, double radius, Places *p, double *scratch,
              ChangePoint *found)
{
    Hypothesis event;
    double place, simple = 0.0;
    list_places(f, offset - radius, offset + radius, MOST_EVENT, p);
    if (best_place(f, 0, EVENTS, p, &place) < ENOUGH)
        return 0;
    list_places(f, -INFINITY, INFINITY, MOST_ORDER, p);
    best_place(f, 0, EVENTS, p, &place);
    if (fabs(place - offset) > radius + 0.5 * p->step)
        return 0;
    find_order(f, place, p->step, &event, found);
    double odds = found->gain - larger(best_place(f, EVENTS, SETS, p, &place), 0.0);
    if (fabs(found->place - offset) > radius || odds < ENOUGH)
        return 0;
    for (int part = 0; part < 2; part++)
        simple += event.degree[part] <= SIMPLE_DEGREE ? event.gain[part] : 0.0;
    if (found->step_order > 1 && simple < ENOUGH)
        return 0;
    return !shorter || is_confirmed(f, f + 1, &event, found->place, scratch);
}

int
kinpole_find_event(const double *time, const double *values, long long count, long long after,
                   double offset, double radius, ChangePoint *found)
{
    Fit fits[MAX_WINDOWS];
    int number = 0, code = 0;
    size_t of_basis = (MAX_DEGREE + 1) * count;
    double *memory = malloc((MAX_WINDOWS * of_basis + 3 * count) * sizeof(double));
    Places *places = malloc(sizeof *places);
    int is_last = !memory || !places;
    for (; !is_last && number < MAX_WINDOWS; after = (after + 1) / 2) {
        is_last = after <= SHORTEST;
        after = is_last ? SHORTEST : after;
        number += fit_window(time, values, count, after, memory + number * of_basis, fits + number);
    }
    for (int k = number - 1; k >= 0 && !code; k--)
        code = search_window(fits + k, number - 1 - k, offset, radius, places,
                             memory + MAX_WINDOWS * of_basis, found);
    code = !memory || !places ? -1 : code;
    free(memory), free(places);
    return code;
}
