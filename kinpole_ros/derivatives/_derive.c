/*
 * From poses at stamps to derivatives at instants with covariances: `derive_poses` of _poses.py.
 *
 * Nothing is remembered: the results at an instant depend on the poses in its window alone. Each
 * instant and body is one signal, of an angle and two coordinates. _derive_avx2.c compiles this
 * file again for processors with wider vectors, since a package may be built elsewhere.
 */

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#ifndef WIDTH
#define WIDTH 2
#endif
#include "_evidence.h"
#include "_window.h"

/* The kind of a window, and the instant in it. */
typedef struct {
    long long block, orders;
    int exact, dense, parts;
    double at; /* the instant, samples from the middle */
} Window;

/* Find a table; NULL if it has to be made. */
static const Table *
find_table(Call *call, const Window *window, long long count, long long orders, double at)
{
    long long flags = window->exact + 2 * window->dense;
    call->lacking = (Table){count, window->block, flags, orders, at, NULL, NULL};
    for (const Table *t = call->tables; t < call->tables + call->table_count; t++)
        if (!memcmp(t, &call->lacking, offsetof(Table, integers)))
            return t;
    return NULL;
}

static void
unpack_models(const Table *table, Models *m)
{
    const long long *head = table->integers;
    m->count = table->count, m->half = (m->count + 1) / 2, m->exact = table->flags & 1;
    m->processes = head[0], m->chunks = head[1], m->kinds = head[2], m->odd = head[3];
    m->rows = head[4], m->groups = m->processes * m->chunks;
    m->first = head + 5, m->kind = m->first + 2 * (m->processes + 1);
    m->panels = (const Lanes *)table->numbers;
    m->share = m->left = m->panels + m->rows / LANES * m->half;
    if (m->exact)
        m->left = m->share + m->chunks * m->rows;
    m->chances = m->left + m->chunks * m->rows, m->freedom = m->chances + 2 * m->groups;
}

/* Lay out the arrays for a window, and list the cells with a weight below 1. */
static int
prepare(const Models *m, long long orders, const Samples *s, Work *w)
{
    w->cells = 0, w->parts = 1, w->known = KNOWN, w->seen[0] = w->seen[1] = 0.0;
    for (long long k = 0; k < s->count; k++) {
        double a = s->weight[0][k], p = s->weight[1][k];
        w->seen[0] += a, w->seen[1] += p;
        w->cells += a < 1.0 || p < 1.0;
        if (a != p)
            w->parts = 2;
    }
    long long number = w->cells, pairs = number * (number + 1) / 2, half = m->half + LANES;
    long long columns = pairs > 3 * orders ? pairs : 3 * orders;
    columns = (3 + orders) * number > columns ? (3 + orders) * number : columns;
    long long of_models = m->groups * (8 + 3 * orders + w->parts * pairs + 3 * number);
    long long of_lanes = of_models + pairs + (4 + 2 * orders) * number + 6 * SLOPES * half / LANES;
    long long of_numbers = (6 + number) * m->rows + (columns + 6) * half + pairs + 9 * number;
    char *data = buffer(OF_MODELS, 8 * (of_lanes * LANES + of_numbers + m->groups));
    if (!data)
        return NO_MEMORY;
#define TAKE(array, size) (array = (void *)data, data += (size) * sizeof *array)
    TAKE(w->evidence, 2 * m->groups), TAKE(w->variance, 2 * m->groups);
    TAKE(w->likely, 2 * m->groups), TAKE(w->counting, 2 * m->groups);
    TAKE(w->apart, 3 * orders * m->groups);
    TAKE(w->factors, w->parts * pairs * m->groups), TAKE(w->errors, 3 * number * m->groups);
    TAKE(w->off, pairs + 3 * number), TAKE(w->reach, orders * number);
    TAKE(w->scaled, (orders + 1) * number), TAKE(w->along, 6 * SLOPES * (half / LANES));
    TAKE(w->modes, 3 * m->rows), TAKE(w->squares, 3 * m->rows), TAKE(w->vectors, number * m->rows);
    TAKE(w->terms, (columns + 6) * half), TAKE(w->base, pairs + 3 * number);
    TAKE(w->weight, 2 * number), TAKE(w->root, 2 * number), TAKE(w->at, number);
    TAKE(w->counts, m->groups);
#undef TAKE
    for (long long k = 0, x = 0; k < s->count; k++)
        if (s->weight[0][k] < 1.0 || s->weight[1][k] < 1.0) {
            w->at[x] = k;
            for (long long part = 0; part < w->parts; part++) {
                w->weight[part * number + x] = s->weight[part][k];
                w->root[part * number + x] = sqrt(1.0 - s->weight[part][k]);
            }
            x++;
        }
    return DONE;
}

/* Compute the evidence of samples, and derivatives at an instant if these are wanted. */
static int
find_derivatives(Call *call, const Window *window, const Samples *s, double at, int wanted,
                 Found *out)
{
    Models m;
    Work w;
    const Table *table = find_table(call, window, s->count, 0, 0.0), *stencils = NULL;
    if (!table || (wanted && !(stencils = find_table(call, window, s->count, window->orders, at))))
        return LACKING;
    unpack_models(table, &m);
    if (prepare(&m, window->orders, s, &w))
        return NO_MEMORY;
    if (!wanted) {
        weigh_models(&m, s, &w, out->evidence);
        out->seen[0] = w.seen[0], out->seen[1] = w.seen[1];
        return DONE;
    }
    long long modes = window->orders * m.rows;
    Stencils by = {window->orders, stencils->numbers, (const Lanes *)(stencils->numbers + modes)};
    differentiate(&m, &by, s, &w, out);
    return DONE;
}

/* The logarithm of how probable samples are by all models: their evidence is relative to a line
   with a flat prior, and to so many samples. */
static double
chance_of(const Call *call, const Found *found, int c)
{
    double number = KNOWN + found->seen[c] * (c + 1);
    return found->evidence[c] - 2 * call->flat * (c + 1) - log(number) / 2 + log(KNOWN) / 2;
}

/* Average the results of whole and divided windows by the logarithms of their chances. */
static void
mix(const Found *all, double (*chances)[2], int number, long long orders, Found *out)
{
    for (int c = 0; c < 3; c++) {
        double most = -INFINITY, sum = 0.0, share[NEWER_PARTS + 1];
        int d = c > 0;
        for (int f = 0; f < number; f++)
            most = larger(most, chances[f][d]);
        for (int f = 0; f < number; f++)
            sum += share[f] = exp(chances[f][d] - most);
        for (int f = 0; f < number; f++)
            share[f] /= sum;
        for (long long k = 0; k < orders; k++)
            out->mean[c][k] = 0.0;
        if (c < 2) {
            out->freedom[d] = 0.0;
            memset(out->covariance[d], 0, sizeof out->covariance[d]);
        }
        for (int f = 0; f < number; f++)
            for (long long k = 0; k < orders; k++)
                out->mean[c][k] += share[f] * all[f].mean[c][k];
        for (int f = 0; f < number; f++) {
            if (c < 2)
                out->freedom[d] += share[f] * all[f].freedom[d];
            for (long long k = 0; k < orders; k++)
                for (long long j = 0; j < orders; j++) {
                    double off = (all[f].mean[c][k] - out->mean[c][k]) *
                                 (all[f].mean[c][j] - out->mean[c][j]) / (d + 1);
                    out->covariance[d][k][j] += share[f] *
                        (off + (c < 2 ? all[f].covariance[d][k][j] : 0.0));
                }
        }
    }
}

/* Differentiate a window as a whole, or as two parts with motions of their own. The chance of a
   division follows from the evidence of both parts, each with its own mean and slope. Derivatives
   are those of the part with the instant in it. */
static int
derive_parts(Call *call, const Window *window, const Samples *s, Found *out)
{
    Found all[NEWER_PARTS + 1];
    double chances[NEWER_PARTS + 1][2];
    int number = 1, code = find_derivatives(call, window, s, window->at, 1, out);
    /* With more evidence than that no division can pay. */
    if (code || window->exact || !window->parts || !(out->evidence[0] < -WORTH * call->flat ||
                                                     out->evidence[1] < -WORTH * call->flat * 2))
        return code;
    all[0] = *out;
    for (int c = 0; c < 2; c++)
        chances[0][c] = chance_of(call, out, c);
    for (int n = 0; n < NEWER_PARTS; n++) {
        long long cut = s->count - (long long)rint(newer_parts[n] * s->count);
        Samples halves[2] = {*s, *s};
        Found found[2];
        int enough = 1, later = window->at + (s->count - 1) / 2.0 >= cut - 0.5;
        halves[0].count = cut, halves[1].count = s->count - cut;
        for (int c = 0; c < 3; c++)
            halves[1].x[c] += cut;
        for (int c = 0; c < 2; c++) {
            halves[1].weight[c] += cut;
            for (int half = 0; half < 2; half++) {
                double seen = 0.0;
                for (long long k = 0; k < halves[half].count; k++)
                    seen += halves[half].weight[c][k];
                enough &= seen >= FEWEST_OF_PART;
            }
        }
        for (int half = 0; half < 2 && enough && !code; half++) {
            double at = window->at + (half ? -cut : s->count - cut) / 2.0;
            code = find_derivatives(call, window, halves + half, at, half == later, found + half);
        }
        if (code)
            return code;
        if (!enough)
            continue;
        for (int c = 0; c < 2; c++)
            chances[number][c] = chance_of(call, found, c) + chance_of(call, found + 1, c) +
                log(PARTS_PRIOR / (1 - PARTS_PRIOR) / NEWER_PARTS);
        all[number++] = found[later];
    }
    mix(all, chances, number, window->orders, out);
    return DONE;
}

/* Move samples to the even grid along the estimated motion, and estimate it again until they
   settle. `more` is the factor by which the last movement increases their noise. */
static int
put_in_place(Call *call, const Window *window, Samples *s, double *spare, double *more)
{
    Models m;
    Work w;
    const Table *table = find_table(call, window, s->count, 0, 0.0);
    const Table *slopes = table ? find_table(call, window, s->count, -1, 0.0) : NULL;
    if (!slopes)
        return LACKING;
    unpack_models(table, &m);
    if (prepare(&m, 1, s, &w))
        return NO_MEMORY;
    Samples placed = *s;
    double *moved[3], left[2] = {0.0};
    for (int c = 0; c < 3; c++)
        placed.x[c] = spare + c * s->count, moved[c] = spare + (3 + c) * s->count;
    move_by_neighbors(s, placed.x);
    int settled[2] = {0}, rounds = window->exact ? MORE_ROUNDS : ROUNDS;
    /* Samples that are off by little settle in the first round. */
    for (int round = 0; round < rounds + 3 && !(settled[0] && settled[1]); round++) {
        w.known = round == 0 || round > rounds ? KNOWN : KNOWN_MEANWHILE;
        move(&m, (const Lanes *)slopes->numbers, s, &placed, &w, moved);
        /* Of both coordinates, whichever way the axes lie. */
        double square[2] = {0.0};
        for (int c = 0; c < 3; c++)
            for (long long k = 0; k < (settled[c > 0] ? 0 : s->count); k++) {
                double step = moved[c][k] - placed.x[c][k];
                square[c > 0] += step * step;
                placed.x[c][k] = moved[c][k];
            }
        for (int c = 0; c < 2; c++)
            if (!settled[c]) {
                left[c] = sqrt(square[c] / (c + 1) / s->count);
                settled[c] = left[c] <= (window->exact ? 0.0 : SETTLED);
            }
    }
    for (int c = 0; c < 2; c++)
        more[c] = sqrt(1 + left[c] * left[c]);
    memcpy(s->x[0], placed.x[0], 3 * s->count * sizeof(double));
    divide(s, more);
    return DONE;
}

static void
scale_found(Found *found, const double *by)
{
    for (int k = 0; k < MOST_ORDERS; k++) {
        for (int c = 0; c < 3; c++)
            found->mean[c][k] *= by[c > 0];
        for (int j = 0; j < MOST_ORDERS; j++)
            for (int c = 0; c < 2; c++)
                found->covariance[c][k][j] *= by[c] * by[c];
    }
}

/* Differentiate samples some of which may be missing, or off the even grid. */
static int
derive_uneven(Call *call, const Window *window, const Samples *given, double *spare, Found *out)
{
    long long n = given->count, lacking = 0;
    Samples s = *given;
    double noise[2] = {1.0, 1.0}, more[2] = {1.0, 1.0};
    int late = 0;
    memcpy(spare, given->x[0], 6 * n * sizeof(double));
    for (int c = 0; c < 3; c++)
        s.x[c] = spare + c * n;
    s.weight[0] = spare + 3 * n, s.weight[1] = spare + 4 * n;
    for (long long k = 0; k < n; k++) {
        lacking += s.weight[0][k] < 1 || s.weight[1][k] < 1;
        late |= s.off[k] != 0.0;
    }
    /* To treat many weights exactly takes too long: all samples get the mean variance. */
    for (int c = 0; c < (lacking > MOST_LACKING ? 2 : 0); c++) {
        double sum = 0.0, number = 0.0;
        for (long long k = 0; k < n; k++)
            if (s.weight[c][k] > 0)
                sum += 1 / s.weight[c][k], number += 1, s.weight[c][k] = 1.0;
        noise[c] = sqrt(sum / larger(number, 1.0));
    }
    divide(&s, noise);
    if (lacking)
        fill_missing(&s);
    int code = late ? put_in_place(call, window, &s, spare + 6 * n, more) : DONE;
    if (!code)
        code = derive_parts(call, window, &s, out);
    if (code)
        return code;
    for (int c = 0; c < 2; c++)
        more[c] *= noise[c];
    scale_found(out, more);
    int finite = 1;
    for (long long k = 0; k < 3 * window->orders; k++)
        finite &= isfinite(out->mean[k / window->orders][k % window->orders]);
    if (finite || !window->exact)
        return DONE;
    /* In a long gap of a motion much larger than its noise the matrix of the missing samples is
       singular by rounding. Then the noise is taken as the least of a window that is not exact. */
    Window noisy = *window;
    noisy.exact = 0;
    for (int c = 0; c < 2; c++)
        noise[c] = larger(largest_of(given, c) / EXACT, 1.0);
    divide(given, noise);
    code = derive_uneven(call, &noisy, given, spare, out);
    scale_found(out, noise);
    return code;
}

/* The results of a signal, per s: position (orders, T B, 2), angle (orders, T B), covariances
   (orders, orders, T B) of one coordinate and of the angle, the length of the window, s, and the
   parameters of the angle's motion (T B). All are NaN where nothing was found. */
static void
write_results(const Call *call, long long signal, long long now, const Found *found,
              const double (*of)[MOST_ORDERS], double span)
{
    long long orders = call->orders, all = call->instants * call->bodies;
    double *position = call->results + 2 * signal;
    double *angle = call->results + 2 * orders * all + signal;
    double *of_position = angle + orders * all, *of_angle = of_position + orders * orders * all;
    double *rest = of_angle + orders * orders * all;
    for (long long k = 0; k < orders; k++) {
        double base[3] = {call->angle[now], call->position[2 * now], call->position[2 * now + 1]};
        angle[k * all] = found ? found->mean[0][k] * of[0][k] + (k ? 0.0 : base[0]) : NAN;
        for (int c = 0; c < 2; c++)
            position[2 * k * all + c] =
                found ? found->mean[1 + c][k] * of[1][k] + (k ? 0.0 : base[1 + c]) : NAN;
        for (long long j = 0; j < orders; j++) {
            of_angle[(k * orders + j) * all] =
                found ? found->covariance[0][k][j] * of[0][k] * of[0][j] : NAN;
            of_position[(k * orders + j) * all] =
                found ? found->covariance[1][k][j] * of[1][k] * of[1][j] : NAN;
        }
    }
    rest[0] = span, rest[all] = found ? found->freedom[0] : NAN;
}

static int
derive_signal(Call *call, long long instant, long long body, const Grid *grid)
{
    Samples cells = {0}, s;
    Found found;
    long long count, ahead, block, size, signal = instant * call->bodies + body;
    long long now = call->windows[instant] * call->bodies + body;
    double unit[2], coarser[2] = {1.0, 1.0}, of[2][MOST_ORDERS], interval = grid->interval * 1e-9;
    int exact = 0;
    if (fill_cells(call, instant, body, grid, &cells, &count, &ahead, unit, &exact))
        return NO_MEMORY;
    double length = rint(call->window / interval) + 1;
    long long whole = length > FEWEST_SAMPLES ? (long long)length : FEWEST_SAMPLES;
    size = count ? choose_size(&cells, count, whole, ahead, exact, &block) : 0;
    if (!size)
        write_results(call, signal, now, NULL, NULL, NAN);
    if (size <= 0)
        return size ? NO_MEMORY : DONE;
    if (!make_room(&s, OF_WINDOW, 3 * size))
        return NO_MEMORY;
    double *data = s.x[0], *spare = data + 6 * size;
    s.count = size;
    for (int c = 0; c < 3; c++)
        s.x[c] = data + c * size;
    s.weight[0] = data + 3 * size, s.weight[1] = data + 4 * size, s.off = data + 5 * size;
    average(&cells, block, &s, coarser);
    Window window = {block, call->orders, exact, call->effort == HIGH_EFFORT,
                     call->effort != LOW_EFFORT, 0.0};
    window.at = (size - 1) / 2.0 - (ahead - (block - 1) / 2.0) / block;
    int code = derive_uneven(call, &window, &s, spare, &found);
    if (code)
        return code;
    interval *= block;
    for (int c = 0; c < 2; c++)
        for (int k = 0; k < MOST_ORDERS; k++)
            of[c][k] = unit[c] * coarser[c] * pow(interval, -k);
    write_results(call, signal, now, &found, of, (size - 1) * interval);
    return DONE;
}

#ifdef KINPOLE_DERIVE
int
KINPOLE_DERIVE(Call *call)
#else
static int
derive_anywhere(Call *call)
#endif
{
    Grid grid = {0};
    long long found_of = -1;
    for (; call->next < call->instants * call->bodies; call->next++) {
        long long instant = call->next / call->bodies, body = call->next % call->bodies;
        const long long *windows = call->windows + instant;
        long long oldest = windows[call->instants], newest = windows[2 * call->instants];
        long long frames = newest - oldest + 1;
        int code = DONE;
        if (windows[0] < 0 || oldest < 0 || windows[0] >= call->frames || newest >= call->frames ||
            call->left_out[call->next] < 0)
            return NO_FRAMES;
        if (frames < 2) {
            write_results(call, call->next, windows[0] * call->bodies + body, NULL, NULL, NAN);
            continue;
        }
        if (found_of != instant)
            code = find_grid(call->time, windows[0], newest, frames, &grid);
        found_of = instant;
        if (!code)
            code = derive_signal(call, instant, body, &grid);
        if (code)
            return code;
    }
    return DONE;
}

#ifndef KINPOLE_DERIVE
#if defined(__x86_64__)
int kinpole_derive_avx2(Call *call);
#endif

/* Returns 0, or why it has to be called again, or that there is no memory. */
#ifdef _WIN32
__declspec(dllexport)
#endif
int
kinpole_derive(Call *call)
{
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        return kinpole_derive_avx2(call);
#endif
    return derive_anywhere(call);
}
#endif
