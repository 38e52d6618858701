/*
 * From poses at stamps to derivatives at instants with covariances: `derive_poses` of
 * _pose_derivatives.py.
 * __init__.py has an overview of the algorithm.
 *
 * One instant of one body is a signal of an angle and two coordinates; its number is the instant
 * times the bodies, plus the body. Its result depends on the poses in its window alone:
 *
 *   derive_signal    finds the grid, fills cells and blocks (window.c, samples.c)
 *   derive_uneven    fills missing samples, moves others to the even grid (samples.c, mean.c)
 *   derive_even      evaluates models (evidence.c), searches events (events.c), averages (mean.c),
 *                    mixes segments into the result (segments.c), finds hubs (hub.c)
 *   write_results    converts samples to seconds, and deviations of the noise to rad and m
 */

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "window.h"
#include "estimator.h"
#include "events.h"
#include "segments.h"
#include "evidence.h"
#include "hub.h"
#include "memory.h"
#include "numbers.h"

/* The noise prior, in samples: a window has less information on its noise than the measurement. */
#define NOISE_PRIOR_SAMPLES 300.0
/* Rounds in which samples move, besides the first and the last two. */
#define MAX_ROUNDS 6
/* The same for exact samples, whose noise does not hide what is left of the movement. */
#define MAX_EXACT_ROUNDS 38
/* Samples that move by less than so many deviations of their noise are settled. */
#define SETTLED_SIGMAS 0.05
/* Noise prior, in samples, while samples move: their noise is larger than the measured one. */
#define MOVING_PRIOR_SAMPLES 1.0
/* Without a likely event a window is divided into segments if the best log evidence of its models,
   of a signal, is below the negative of this: a process may explain what is an event. Divided at
   any evidence, motion that sets in gradually after rest has twice the error. */
#define DIVIDE_BELOW 48.0

/* Cells of a window at most: more than any has, and an integer. */
#define MAX_LENGTH 1e15

#ifndef DERIVE_SIGNALS
#define DERIVE_SIGNALS derive_signals
#endif

/* The kind of a window, which needs tables of its own, and the instant in it. */
typedef struct {
    long long block, orders;
    long long spectrum; /* of the body, its number; 0 for none */
    int exact;
    double from_middle; /* the instant, samples after the middle of the window */
    double radians;     /* the unit of the angle */
} Window;

/* Find or make the table of a window of `count` samples: MODELS, SLOPES, or stencils of so many
   `orders` at the instant `from_middle`. Writes `table`. Returns DONE or NO_TABLE. */
static int
find_table(Call *call, const Window *window, long long count, long long orders,
           double from_middle, Table *table)
{
    *table = (Table){count, window->block, window->exact, orders, window->spectrum, from_middle,
                     NULL, NULL};
    for (const Table *t = call->tables; t < call->tables + call->table_count; t++)
        if (!memcmp(t, table, offsetof(Table, integers))) {
            *table = *t;
            return DONE;
        }
    return call->make_table(table);
}

/* Let `m` point to the arrays of a table of `models_of`, in their order there. */
static void
unpack_models(const Table *table, Models *m)
{
    const long long *head = table->integers;
    m->count = table->count;
    m->half = (m->count + 1) / 2;
    m->exact = table->exact;
    m->processes = head[0];
    m->chunks = head[1];
    m->spectra = head[2];
    m->first_odd = head[3];
    m->rows = head[4];
    m->body_begin = head[5] * m->chunks, m->body_end = head[6] * m->chunks;
    m->groups = m->processes * m->chunks;
    m->first_row = head + 7;
    m->spectrum = m->first_row + 2 * (m->processes + 1);
    m->basis = (const Lanes *)table->numbers;
    m->shrinkage = m->residual_factor = m->basis + m->rows / LANES * m->half;
    if (m->exact)
        m->residual_factor = m->shrinkage + m->chunks * m->rows;
    m->log_prior = m->residual_factor + m->chunks * m->rows;
    m->parameters = m->log_prior + 2 * m->groups;
    m->step_squares = (const double *)(m->parameters + m->groups);
    m->of_rest = m->step_squares + m->groups * LANES * STEP_ORDERS * m->count;
}

/* Lay out the arrays of `w` and `set` for a window and so many `orders`. The set has the samples
   with a weight below 1, and their coefficients, and no steps; the scratch memory of `w` suffices
   for sets with steps. Returns DONE or NO_MEMORY. */
static int
prepare_window(Call *call, const Models *m, long long orders, const Samples *s, Work *w, Set *set)
{
    long long low = 0;
    int parts = 1;
    w->prior_samples = NOISE_PRIOR_SAMPLES, w->total_weight[0] = w->total_weight[1] = 0.0;
    for (long long k = 0; k < s->count; k++) {
        double a = s->weight[0][k], p = s->weight[1][k];
        w->total_weight[0] += a, w->total_weight[1] += p;
        low += a < 1.0 || p < 1.0;
        if (a != p)
            parts = 2;
    }
    long long most = low + (m->exact ? 0 : EVENT_COLUMNS), pairs = most * (most + 1) / 2;
    long long half = m->half + LANES, terms = pairs + (3 + orders) * most + 3 * orders + 6;
    long long of_lanes = 3 * m->groups + pairs + 3 * most + half + (3 * orders + 1) * most +
                         6 * SLOPE_ORDERS * (half / LANES);
    long long of_numbers = 6 * m->rows + terms * half;
    size_t of_set = size_of_set(m, orders, low, 0, parts);
    char *data = kinpole_buffer(call, OF_MODELS, of_set + 8 * (of_lanes * LANES + of_numbers));
    if (!data)
        return NO_MEMORY;
    data = lay_out_set(m, orders, low, 0, parts, data, set);
    TAKE(w->residual, 3 * m->groups), TAKE(w->column_products, pairs + 3 * most + half);
    TAKE(w->column_effects, 2 * orders * most), TAKE(w->over_pivots, (orders + 1) * most);
    TAKE(w->slopes, 6 * SLOPE_ORDERS * (half / LANES));
    TAKE(w->coefficients, 3 * m->rows), TAKE(w->squares, 3 * m->rows), TAKE(w->terms, terms * half);
    set->low_samples = low;
    for (long long k = 0, x = 0; k < s->count; k++)
        if (s->weight[0][k] < 1.0 || s->weight[1][k] < 1.0) {
            set->low_sample[x] = k;
            for (int part = 0; part < parts; part++) {
                set->weight[part * low + x] = s->weight[part][k];
                set->root[part * low + x] = sqrt(1.0 - s->weight[part][k]);
            }
            x++;
        }
    project_low_samples(m, set);
    return DONE;
}

/* Replace the position in `out` by that of a hub of the samples, if there is one; its path has no
   events. Then `w` and `none`, the set without events, become those of its samples. Returns
   NO_MEMORY or DONE. */
static int
derive_hub(Call *call, const Window *window, const Models *m, const Stencils *stencils,
           const Samples *s, Work *w, Set *none, Estimate *out)
{
    Samples own = *s;
    Estimate moved;
    Hub hub;
    if (find_hub(call, stencils, window->radians, out->evidence[1], &own, &hub))
        return NO_MEMORY;
    if (!hub.growth)
        return DONE;
    project_samples(m, &own, w);
    evaluate_models(m, &own, w, none);
    differentiate(m, stencils, w, none, 1, &moved);
    take_hub(&hub, &moved, window->radians, stencils->orders, out);
    return DONE;
}

/* Differentiate even samples at the instant of a window, into `out`. Returns the same as
   `kinpole_derive`. */
static int
derive_even(Call *call, const Window *window, const Samples *s, Estimate *out)
{
    Models m;
    Work w;
    Set sets[MAX_SETS];
    int number = 1;
    Table models, of_instant;
    if (find_table(call, window, s->count, MODELS, 0.0, &models) ||
        find_table(call, window, s->count, window->orders, window->from_middle, &of_instant))
        return NO_TABLE;
    unpack_models(&models, &m);
    if (prepare_window(call, &m, window->orders, s, &w, sets))
        return NO_MEMORY;
    project_samples(&m, s, &w);
    evaluate_models(&m, s, &w, sets);
    long long modes = window->orders * m.rows;
    Stencils stencils = {window->orders, window->from_middle + (s->count - 1) / 2.0,
                         of_instant.numbers, (const Lanes *)(of_instant.numbers + modes)};
    if (!window->exact &&
        search_events(call, &m, &stencils, s, &w, window->block, sets, &number))
        return NO_MEMORY;
    int is_divided = number > 1 || sets->best_evidence[0] < -DIVIDE_BELOW ||
        sets->best_evidence[1] < -2 * DIVIDE_BELOW;
    if (!window->spectrum || is_divided)
        differentiate(&m, &stencils, &w, sets, number, out);
    if (window->exact)
        return DONE;
    if (is_divided && add_segments(call, &stencils, s, out))
        return NO_MEMORY;
    /* The spectrum of the body is that of a stationary motion, which an event is not. */
    if (window->spectrum && !(is_divided && larger(out->event[0], out->event[1]) > 0.5)) {
        add_body(&m, sets, number);
        differentiate(&m, &stencils, &w, sets, number, out);
    }
    return derive_hub(call, window, &m, &stencils, s, &w, sets, out);
}

/* Move samples to the even grid along the estimated motion, and estimate it again, until angle and
   position settle, each by itself. Writes the moved samples to `s`, and to `factor` (2) by how much
   the last movement, as if it were noise, increases the standard deviation of the noise. The
   signals of `s` follow each other in memory; `scratch` is memory for 6 signals. Returns the same
   as `kinpole_derive`. */
static int
move_until_settled(Call *call, const Window *window, Samples *s, double *scratch, double *factor)
{
    Models m;
    Work w;
    Set set;
    Table models, slopes;
    /* The motion of the window alone, whether there is an event or not. */
    Window common = *window;
    common.spectrum = 0;
    if (find_table(call, &common, s->count, MODELS, 0.0, &models) ||
        find_table(call, &common, s->count, SLOPES, 0.0, &slopes))
        return NO_TABLE;
    unpack_models(&models, &m);
    if (prepare_window(call, &m, 1, s, &w, &set))
        return NO_MEMORY;
    Samples placed = *s;
    double *moved[3], movement[2] = {0.0};
    for (int c = 0; c < 3; c++)
        placed.x[c] = scratch + c * s->count, moved[c] = scratch + (3 + c) * s->count;
    move_by_neighbors(s, placed.x);
    int settled[2] = {0}, rounds = window->exact ? MAX_EXACT_ROUNDS : MAX_ROUNDS;
    for (int round = 0; round < rounds + 3 && !(settled[0] && settled[1]); round++) {
        /* The first round is enough for samples that are hardly off. The last two have the prior of
           the noise again, so that the motion is the one that is differentiated. */
        w.prior_samples = round == 0 || round > rounds ? NOISE_PRIOR_SAMPLES : MOVING_PRIOR_SAMPLES;
        move_to_grid(&m, (const Lanes *)slopes.numbers, s, &placed, &w, &set, moved);
        /* Both coordinates settle together, so that the axes of the plane do not matter. */
        double square[2] = {0.0};
        for (int c = 0; c < 3; c++)
            for (long long k = 0; k < (settled[c > 0] ? 0 : s->count); k++) {
                double step = moved[c][k] - placed.x[c][k];
                square[c > 0] += step * step;
                placed.x[c][k] = moved[c][k];
            }
        for (int c = 0; c < 2; c++)
            if (!settled[c]) {
                movement[c] = sqrt(square[c] / (c + 1) / s->count);
                settled[c] = movement[c] <= (window->exact ? 0.0 : SETTLED_SIGMAS);
            }
    }
    for (int c = 0; c < 2; c++)
        factor[c] = sqrt(1 + movement[c] * movement[c]);
    memcpy(s->x[0], placed.x[0], 3 * s->count * sizeof(double));
    divide_samples(s, factor);
    return DONE;
}

/* Multiply derivatives, standard deviations and hub of an estimate by the numbers `factor` (2). */
static void
scale_estimate(Estimate *found, const double *factor)
{
    found->hub *= factor[1];
    for (int k = 0; k < MAX_ORDERS; k++) {
        for (int c = 0; c < 3; c++)
            found->mean[c][k] *= factor[c > 0];
        for (int j = 0; j < MAX_ORDERS; j++)
            for (int c = 0; c < 2; c++)
                found->covariance[c][k][j] *= factor[c] * factor[c];
    }
}

/* Differentiate samples some of which may be missing, of low weight, or off the even grid, into
   `out`. `scratch` is memory for 12 signals. The arrays of `uneven` follow each other in memory,
   and stay, unless the motion is exact and comes out infinite. Returns the same as
   `kinpole_derive`. */
static int
derive_uneven(Call *call, const Window *window, const Samples *uneven, double *scratch,
              Estimate *out)
{
    long long n = uneven->count, low_samples = 0;
    Samples s = *uneven;
    double noise[2] = {1.0, 1.0}, moving[2] = {1.0, 1.0};
    int is_uneven = 0;
    memcpy(scratch, uneven->x[0], 6 * n * sizeof(double));
    for (int c = 0; c < 3; c++)
        s.x[c] = scratch + c * n;
    s.weight[0] = scratch + 3 * n, s.weight[1] = scratch + 4 * n;
    for (long long k = 0; k < n; k++) {
        low_samples += s.weight[0][k] < 1 || s.weight[1][k] < 1;
        is_uneven |= s.off[k] != 0.0;
    }
    /* The cost goes by the square of the low weights. If there are many, all samples that are not
       missing get the mean variance. */
    for (int c = 0; c < (low_samples > MAX_LOW_WEIGHT ? 2 : 0); c++) {
        double sum = 0.0, number = 0.0;
        for (long long k = 0; k < n; k++)
            if (s.weight[c][k] > 0)
                sum += 1 / s.weight[c][k], number += 1, s.weight[c][k] = 1.0;
        noise[c] = sqrt(sum / larger(number, 1.0));
    }
    divide_samples(&s, noise);
    if (low_samples)
        fill_missing(&s);
    int code = is_uneven ? move_until_settled(call, window, &s, scratch + 6 * n, moving) : DONE;
    Window in_noise = *window;
    in_noise.radians *= noise[0] * moving[0];
    if (!code)
        code = derive_even(call, &in_noise, &s, out);
    if (code)
        return code;
    for (int c = 0; c < 2; c++)
        moving[c] *= noise[c];
    scale_estimate(out, moving);
    int finite = 1;
    for (long long k = 0; k < 3 * window->orders; k++)
        finite &= isfinite(out->mean[k / window->orders][k % window->orders]);
    if (finite || !window->exact)
        return DONE;
    /* In a long gap of an exact motion the matrix of the missing samples is singular by rounding.
       Then the noise is taken to be the least with which a window is not exact. */
    Window noisy = *window;
    noisy.exact = 0;
    for (int c = 0; c < 2; c++)
        noise[c] = larger(largest_sample(uneven, c) / EXACT_RATIO, 1.0);
    divide_samples(uneven, noise);
    noisy.radians *= noise[0];
    code = derive_uneven(call, &noisy, uneven, scratch, out);
    scale_estimate(out, noise);
    return code;
}

/* Write the derivatives of the signal with this number, of the body with the pose `now`, an element
   of (N, B): an estimate relative to that pose, in units of `scale` (2, orders), rad/s^k and m/s^k.
   Without an estimate they are NaN. `span` is the length of the window, s. */
static void
write_results(const Call *call, long long signal, long long now, const Estimate *estimate,
              const double (*scale)[MAX_ORDERS], double span)
{
    const DerivativeArrays *out = &call->derivatives;
    long long orders = call->orders, all = call->instants * call->bodies;
    Number arm = estimate ? estimate->hub * scale[1][0] : NAN;
    if (arm != 0.0) /* turned into the frame of the body */
        arm *= cos(call->angle[now]) - I * sin(call->angle[now]);
    for (long long k = 0; k < orders; k++) {
        Number place = call->position[now];
        double base[3] = {call->angle[now], creal(place), cimag(place)};
        double value[3];
        for (int c = 0; c < 3; c++)
            value[c] =
                estimate ? estimate->mean[c][k] * scale[c > 0][k] + (k ? 0.0 : base[c]) : NAN;
        out->angle[k * all + signal] = value[0];
        out->position[k * all + signal] = value[1] + I * value[2];
        for (long long j = 0; j < orders; j++) {
            long long at = (k * orders + j) * all + signal;
            out->angle_covariance[at] =
                estimate ? estimate->covariance[0][k][j] * scale[0][k] * scale[0][j] : NAN;
            out->position_covariance[at] =
                estimate ? estimate->covariance[1][k][j] * scale[1][k] * scale[1][j] : NAN;
        }
    }
    out->reference[signal] = arm;
    out->span[signal] = span;
    out->parameters[signal] = estimate ? estimate->parameters : NAN;
}

/* Derive the signal of a body at an instant from the frames of its window, on their `grid`, and
   write the results; NaN without enough of them. Returns the same as `kinpole_derive`. */
static int
derive_signal(Call *call, long long instant, long long body, const Grid *grid)
{
    Cells cells;
    Samples s;
    Estimate estimate;
    long long block, signal = instant * call->bodies + body;
    long long now = call->windows[instant] * call->bodies + body;
    double coarser[2] = {1.0, 1.0}, scale[2][MAX_ORDERS], interval = grid->interval * 1e-9;
    if (fill_cells(call, instant, body, grid, &cells))
        return NO_MEMORY;
    double length = larger(rint(call->window / interval) + 1, FEWEST_SAMPLES);
    long long whole = (long long)smaller(length, MAX_LENGTH);
    long long size = cells.count ? choose_size(call, &cells, whole, &block) : 0;
    if (!size)
        write_results(call, signal, now, NULL, NULL, NAN);
    if (size <= 0)
        return size ? NO_MEMORY : DONE;
    /* Three times as long: the scratch memory of `derive_uneven` follows the samples. */
    if (!lay_out_samples(call, OF_WINDOW, 3 * size, &s))
        return NO_MEMORY;
    double *data = s.x[0], *scratch = data + 6 * size;
    s.count = size;
    for (int c = 0; c < 3; c++)
        s.x[c] = data + c * size;
    s.weight[0] = data + 3 * size, s.weight[1] = data + 4 * size, s.off = data + 5 * size;
    average_blocks(&cells.samples, block, &s, coarser);
    Window window = {block, call->orders, cells.exact ? 0 : call->spectrum[body], cells.exact, 0.0,
                     cells.unit[0] * coarser[0]};
    window.from_middle = (size - 1) / 2.0 - (cells.ahead - (block - 1) / 2.0) / block;
    int code = derive_uneven(call, &window, &s, scratch, &estimate);
    if (code)
        return code;
    interval *= block;
    for (int c = 0; c < 2; c++)
        for (int k = 0; k < MAX_ORDERS; k++)
            scale[c][k] = cells.unit[c] * coarser[c] * pow(interval, -k);
    write_results(call, signal, now, &estimate, scale, (size - 1) * interval);
    return DONE;
}

int
DERIVE_SIGNALS(Call *call)
{
    Grid grid = {0};
    long long grid_instant = -1;
    for (long long signal = 0; signal < call->instants * call->bodies; signal++) {
        long long instant = signal / call->bodies, body = signal % call->bodies;
        const long long *windows = call->windows + instant;
        long long oldest = windows[call->instants], newest = windows[2 * call->instants];
        long long frames = newest - oldest + 1;
        int code = DONE;
        if (windows[0] < 0 || oldest < 0 || windows[0] >= call->frames || newest >= call->frames ||
            call->left_out[signal] < 0)
            return NO_FRAMES;
        if (frames < 2) {
            write_results(call, signal, windows[0] * call->bodies + body, NULL, NULL, NAN);
            continue;
        }
        if (grid_instant != instant)
            code = find_grid(call, instant, &grid);
        grid_instant = instant;
        if (!code)
            code = derive_signal(call, instant, body, &grid);
        if (code)
            return code;
    }
    return DONE;
}
