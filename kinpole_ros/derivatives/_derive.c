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
#include "_steps.h"
#include "_window.h"

/* The kind of a window, and the instant in it. */
typedef struct {
    long long block, orders;
    int exact;
    double at; /* the instant, samples from the middle */
} Window;

/* Find a table; NULL if it has to be made. */
static const Table *
find_table(Call *call, const Window *window, long long count, long long orders, double at)
{
    call->lacking = (Table){count, window->block, window->exact, orders, at, NULL, NULL};
    for (const Table *t = call->tables; t < call->tables + call->table_count; t++)
        if (!memcmp(t, &call->lacking, offsetof(Table, integers)))
            return t;
    return NULL;
}

static void
unpack_models(const Table *table, Models *m)
{
    const long long *head = table->integers;
    m->count = table->count, m->half = (m->count + 1) / 2, m->exact = table->exact;
    m->processes = head[0], m->chunks = head[1], m->kinds = head[2], m->odd = head[3];
    m->rows = head[4], m->groups = m->processes * m->chunks;
    m->first = head + 5, m->kind = m->first + 2 * (m->processes + 1);
    m->panels = (const Lanes *)table->numbers;
    m->share = m->left = m->panels + m->rows / LANES * m->half;
    if (m->exact)
        m->left = m->share + m->chunks * m->rows;
    m->chances = m->left + m->chunks * m->rows, m->freedom = m->chances + 2 * m->groups;
    m->unexplained = (const double *)(m->freedom + m->groups);
}

/* Lay out the arrays for a window, and list the cells with a weight below 1 in a set without steps.
   The arrays of `w` have room for sets with steps. */
static int
prepare(const Models *m, long long orders, const Samples *s, Work *w, Set *set)
{
    long long cells = 0;
    int parts = 1;
    w->known = KNOWN, w->seen[0] = w->seen[1] = 0.0;
    for (long long k = 0; k < s->count; k++) {
        double a = s->weight[0][k], p = s->weight[1][k];
        w->seen[0] += a, w->seen[1] += p;
        cells += a < 1.0 || p < 1.0;
        if (a != p)
            parts = 2;
    }
    long long most = cells + (m->exact ? 0 : MOST_STEPS), pairs = most * (most + 1) / 2;
    long long half = m->half + LANES, terms = pairs + (3 + orders) * most + 3 * orders + 6;
    long long of_lanes = 3 * m->groups + pairs + 3 * most + half + (3 * orders + 1) * most +
                         6 * SLOPES * (half / LANES);
    long long of_numbers = 6 * m->rows + terms * half;
    size_t of_set = size_of_set(m, orders, cells, 0, parts);
    char *data = buffer(OF_MODELS, of_set + 8 * (of_lanes * LANES + of_numbers));
    if (!data)
        return NO_MEMORY;
    data = lay_out_set(m, orders, cells, 0, parts, data, set);
    TAKE(w->left, 3 * m->groups), TAKE(w->off, pairs + 3 * most + half);
    TAKE(w->reach, 2 * orders * most), TAKE(w->scaled, (orders + 1) * most);
    TAKE(w->along, 6 * SLOPES * (half / LANES));
    TAKE(w->modes, 3 * m->rows), TAKE(w->squares, 3 * m->rows), TAKE(w->terms, terms * half);
    set->cells = cells;
    for (long long k = 0, x = 0; k < s->count; k++)
        if (s->weight[0][k] < 1.0 || s->weight[1][k] < 1.0) {
            set->at[x] = k;
            for (int part = 0; part < parts; part++) {
                set->weight[part * cells + x] = s->weight[part][k];
                set->root[part * cells + x] = sqrt(1.0 - s->weight[part][k]);
            }
            x++;
        }
    find_modes_of_cells(m, set);
    return DONE;
}

/* Search a window for up to two events, and evaluate the models with them. The first of `sets` has
   no events, and its evidence is known. `number` is the number of sets. See _steps.h. */
static int
search_events(const Models *m, const Stencils *by, const Samples *s, const Work *w,
              long long orders, long long block, Set *sets, int *number)
{
    long long cells = sets[0].cells, most = cells + MOST_STEPS, n = m->count;
    Screens screens[2];
    size_t of_set = size_of_set(m, orders, most, MOST_STEPS, 2);
    size_t of_screens = (2 * ((2 + 4 * ORDERS + most) * n + most) + ORDERS * n + 2 * orders * n) *
        sizeof(double);
    size_t of_spare = (1 + ORDERS * MOST_ORDERS) * n * sizeof(double);
    char *data = buffer(OF_SETS, of_spare + 2 * of_screens + (MOST_SETS - 1) * of_set);
    if (!data)
        return NO_MEMORY;
    double *spare;
    TAKE(spare, (1 + ORDERS * MOST_ORDERS) * n);
    for (int k = 0; k < 2; k++) {
        TAKE(screens[k].gain, ORDERS * n), TAKE(screens[k].reach, 2 * orders * n);
        for (int c = 0; c < 2; c++) {
            Screen *screen = screens[k].of + c;
            screen->c = c;
            TAKE(screen->residual, 2 * n), TAKE(screen->sums, 2 * ORDERS * n);
            TAKE(screen->explained, ORDERS * n), TAKE(screen->left, ORDERS * n);
            TAKE(screen->removed, most * n), TAKE(screen->factor, most);
        }
    }
    Candidate found[ORDERS], next[ORDERS];
    for (int k = 0; k < ORDERS; k++)
        found[k].value = next[k].value = -INFINITY;
    for (int slow = 0; slow < 2; slow++) {
        double value = 0.0;
        long long model[2];
        for (int c = 0; c < 2; c++) {
            model[c] = find_likeliest(m, sets, c, slow);
            value += ((const double *)(sets->evidence + c * m->groups))[model[c]];
        }
        if (slow && model[0] == screens->of[0].model && model[1] == screens->of[1].model)
            break;
        for (int c = 0; c < 2; c++) {
            begin_screen(m, s, w, model[c], screens[slow].of + c);
            screen_steps(m, s, w, sets, screens[slow].of + c, spare);
        }
        screens[slow].has_sample_weights = 0;
        find_candidates(m, w, value, screens + slow, found);
    }
    int first = best_candidate(found);
    if (!(found[first].gain >= MIN_GAIN))
        return DONE;
    for (int k = 0; k < ORDERS; k++) {
        if (!(found[k].gain >= MIN_GAIN) ||
            found[k].value < found[first].value - MAX_EVIDENCE_BEHIND)
            continue;
        Set *set = sets + ++*number - 1;
        data = add_event(m, sets, found + k, k, orders, block, data, set, spare);
        add_place_covariance(m, by, sets, found + k, k, w->off, spare, set);
        if (k != first)
            find_evidence(m, s, w, set);
        else
            found[k].sample = *number - 1;
    }
    /* Another event is looked for by the same models, before all models are asked. */
    Set *one = sets + found[first].sample, *two = sets + *number;
    Screens *both = found[first].screens;
    for (int c = 0; c < 2; c++)
        screen_steps(m, s, w, one, both->of + c, spare);
    both->has_sample_weights = 0;
    find_candidates(m, w, 0.0, both, next);
    int second = best_candidate(next);
    if (next[second].gain >= MIN_GAIN) {
        add_event(m, one, next + second, second, orders, block, data, two, spare);
        add_place_covariance(m, by, one, next + second, second, w->off, spare, two);
        find_evidence(m, s, w, two);
        ++*number;
    }
    if (next[second].gain < CERTAIN_GAIN)
        find_evidence(m, s, w, one);
    else
        sets[found[first].sample] = sets[--*number];
    return DONE;
}

/* Differentiate samples at the instant of a window, with all steps there may be. */
static int
derive_even(Call *call, const Window *window, const Samples *s, Found *out)
{
    Models m;
    Work w;
    Set sets[MOST_SETS];
    int number = 1, code = DONE;
    const Table *table = find_table(call, window, s->count, 0, 0.0);
    const Table *stencils =
        table ? find_table(call, window, s->count, window->orders, window->at) : NULL;
    if (!stencils)
        return LACKING;
    unpack_models(table, &m);
    if (prepare(&m, window->orders, s, &w, sets))
        return NO_MEMORY;
    find_squares(&m, s, &w);
    find_evidence(&m, s, &w, sets);
    long long modes = window->orders * m.rows;
    Stencils by = {window->orders, window->at + (s->count - 1) / 2.0, stencils->numbers,
                   (const Lanes *)(stencils->numbers + modes)};
    if (!window->exact && (sets[0].best[0] < -SEARCH_BELOW * call->flat ||
                           sets[0].best[1] < -SEARCH_BELOW * call->flat * 2))
        code = search_events(&m, &by, s, &w, window->orders, window->block, sets, &number);
    if (!code)
        differentiate(&m, &by, &w, sets, number, out);
    return code;
}

/* Move samples to the even grid along the estimated motion, and estimate it again until they
   settle. `more` is the factor by which the last movement increases their noise. */
static int
put_in_place(Call *call, const Window *window, Samples *s, double *spare, double *more)
{
    Models m;
    Work w;
    Set set;
    const Table *table = find_table(call, window, s->count, 0, 0.0);
    const Table *slopes = table ? find_table(call, window, s->count, -1, 0.0) : NULL;
    if (!slopes)
        return LACKING;
    unpack_models(table, &m);
    if (prepare(&m, 1, s, &w, &set))
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
        move(&m, (const Lanes *)slopes->numbers, s, &placed, &w, &set, moved);
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
        code = derive_even(call, window, &s, out);
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
    Window window = {block, call->orders, exact, 0.0};
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
