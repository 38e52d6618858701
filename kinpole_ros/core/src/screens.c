#include <math.h>
#include <string.h>

#include "screens.h"
#include "memory.h"
#include "numbers.h"

/* Samples between a step of the position and the ends of the window, and one more for each order:
   steps of higher orders explain whatever few samples show. */
#define EDGE_SAMPLES 3
/* A step of which the columns leave less than this share is already in the set. */
#define MIN_STEP_LEFT 1e-6

PRIVATE long long
edge_of(int order)
{
    return EDGE_SAMPLES + order;
}

/* Return the number, group times LANES plus lane, of the most probable model of a set, of the angle
   (c = 0) or the position (c = 1). */
static long long
most_probable_model(const Models *m, const Set *set, int c)
{
    const double *evidence = (const double *)(set->evidence + c * m->groups);
    long long best = 0;
    for (long long k = 0; k < m->groups * LANES; k++)
        best = evidence[k] > evidence[best] ? k : best;
    return best;
}

PRIVATE void
subtract_model(const Models *m, long long model, const double *coefficients, const double *signal,
               Lanes *sums, double *residual)
{
    long long group = model / LANES, lane = model % LANES, n = m->count;
    const double *shrinkage = (const double *)(m->shrinkage + group % m->chunks * m->rows) + lane;
    const long long *first = m->first_row + group / m->chunks;
    memcpy(residual, signal, n * sizeof(double));
    for (int parity = 0; parity < 2; parity++, first += m->processes + 1) {
        memset(sums, 0, m->half * sizeof(Lanes));
        for (long long r = first[0] / LANES * LANES; r < first[1]; r += LANES) {
            Lanes factor = all_lanes(0.0);
            for (long long k = r > first[0] ? r : first[0]; k < r + LANES && k < first[1]; k++)
                ((double *)&factor)[k - r] = shrinkage[k * LANES] * coefficients[k];
            for (long long t = 0; t < m->half; t++)
                sums[t] = multiply_add(sums[t], factor, m->basis[r / LANES * m->half + t]);
        }
        for (long long t = 0; t < m->half; t++) {
            double sum = sum_of(sums[t]);
            residual[t] -= t == n - 1 - t ? 2 * sum : sum;
            if (t != n - 1 - t)
                residual[n - 1 - t] -= parity ? -sum : sum;
        }
    }
}

/* Add the sample of low weight with number x to a screen, after those before it: P is reduced by
   the matrix inversion lemma, and so is the residual. */
static void
add_low_sample(const Models *m, const Samples *s, const Work *w, const Set *set, long long x,
               Screen *screen)
{
    long long n = m->count, sample = set->low_sample[x];
    long long at = (set->parts > 1 && screen->c > 0) * set->columns + x;
    double root = set->root[at], *reduced = screen->reduced_columns + x * n;
    memset(reduced, 0, n * sizeof(double)), reduced[sample] = 1.0;
    subtract_model(m, screen->model, set->coefficients + x * m->rows, reduced, w->column_products,
                   reduced);
    for (long long k = 0; k < x; k++) {
        const double *other = screen->reduced_columns + k * n;
        double by = screen->factor[k] * other[sample];
        for (long long t = 0; t < n; t++)
            reduced[t] -= by * other[t];
    }
    double square = reduced[sample] > MIN_STEP_LEFT * MIN_STEP_LEFT ? reduced[sample] : 0.0;
    screen->factor[x] = root > 0.0 ? root * root / (set->weight[at] + root * root * square) : 0.0;
    for (int j = 0; j <= screen->c; j++) {
        double by = screen->factor[x] * dot(reduced, s->x[screen->c + j], n);
        for (long long t = 0; t < n; t++)
            screen->residual[j * n + t] -= by * reduced[t];
    }
}

PRIVATE void
sum_products_with_steps(const double *signal, long long count, double *sums)
{
    double a = 0.0, b = 0.0, c = 0.0;
    for (long long k = count - 1; k >= 0; k--) {
        c += b, b += a, a += signal[k];
        sums[k] = a;
        sums[count + k] = b + a / 2;
        sums[2 * count + k] = c + b + a / 8;
    }
}

/* Add the samples of low weight to a screen, and write its products and squares of steps at all
   places. */
static void
screen_steps(const Models *m, const Samples *s, const Work *w, const Set *set, Screen *screen)
{
    long long n = m->count;
    const double *of_model = m->step_squares + screen->model * STEP_ORDERS * n;
    for (long long x = 0; x < set->low_samples; x++) {
        add_low_sample(m, s, w, set, x, screen);
        double *products = screen->squared_products; /* free until all samples are added */
        sum_products_with_steps(screen->reduced_columns + x * n, n, products);
        for (long long k = 0; k < STEP_ORDERS * n; k++)
            screen->step_squares[k] -= screen->factor[x] * products[k] * products[k];
    }
    memset(screen->squared_products, 0, STEP_ORDERS * n * sizeof(double));
    screen->residual_squares = 0.0;
    for (int j = 0; j <= screen->c; j++) {
        screen->residual_squares += dot(screen->residual + j * n, s->x[screen->c + j], n);
        double *products = screen->step_products + j * STEP_ORDERS * n;
        sum_products_with_steps(screen->residual + j * n, n, products);
        for (long long k = 0; k < STEP_ORDERS * n; k++)
            screen->squared_products[k] += products[k] * products[k];
    }
    screen->residual_squares = larger(screen->residual_squares, 0.0);
    for (long long k = 0; k < STEP_ORDERS * n; k++)
        if (!(screen->step_squares[k] > MIN_STEP_LEFT * of_model[k]))
            screen->step_squares[k] = INFINITY;
}

/* Begin a screen with a model, as if no sample had a low weight: its residual and squares of
   steps. */
static void
begin_screen(const Models *m, const Samples *s, const Work *w, long long model, Screen *screen)
{
    long long n = m->count;
    screen->model = model;
    for (int j = 0; j <= screen->c; j++)
        subtract_model(m, model, w->coefficients + (screen->c + j) * m->rows, s->x[screen->c + j],
                       w->column_products, screen->residual + j * n);
    memcpy(screen->step_squares, m->step_squares + model * STEP_ORDERS * n,
           STEP_ORDERS * n * sizeof(double));
}

/* Find the gains of steps at all places, in `gain` of the screens, and return the best that is not
   at an edge, of -infinity if the window is too short for any. */
static Candidate
find_candidate(const Models *m, const Work *w, Screens *screens)
{
    Candidate best = {.gain = -INFINITY};
    long long n = m->count;
    memset(screens->gain, 0, STEP_ORDERS * n * sizeof(double));
    for (int c = 0; c < 2; c++) {
        const Screen *screen = screens->signal + c;
        double variance = (screen->residual_squares + w->prior_samples) /
            (w->total_weight[c] * (c + 1) + w->prior_samples);
        for (long long k = 0; k < STEP_ORDERS * n; k++)
            screens->gain[k] +=
                screen->squared_products[k] / screen->step_squares[k] / (2 * variance);
    }
    for (int order = 0; order < STEP_ORDERS; order++)
        for (long long k = edge_of(order); k <= n - edge_of(order); k++)
            if (screens->gain[order * n + k] > best.gain)
                best = (Candidate){screens->gain[order * n + k], k, order};
    return best;
}

PRIVATE char *
lay_out_screens(long long count, long long orders, long long low, char *data, Screens *screens)
{
    TAKE(screens->gain, STEP_ORDERS * count), TAKE(screens->sample_weights, 2 * orders * count);
    for (int c = 0; c < 2; c++) {
        Screen *screen = screens->signal + c;
        screen->c = c;
        TAKE(screen->residual, 2 * count), TAKE(screen->step_products, 2 * STEP_ORDERS * count);
        TAKE(screen->squared_products, STEP_ORDERS * count);
        TAKE(screen->step_squares, STEP_ORDERS * count);
        TAKE(screen->reduced_columns, low * count), TAKE(screen->factor, low);
    }
    return data;
}

PRIVATE Candidate
screen_window(const Models *m, const Samples *s, const Work *w, const Set *set, Screens *screens)
{
    for (int c = 0; c < 2; c++) {
        begin_screen(m, s, w, most_probable_model(m, set, c), screens->signal + c);
        screen_steps(m, s, w, set, screens->signal + c);
    }
    return find_candidate(m, w, screens);
}
