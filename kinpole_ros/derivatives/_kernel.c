/*
 * derive of _evidence.py and _moved_once of _samples.py, about ten times as fast for one signal:
 * numpy takes some 100 calls, each of which goes through more of the models than it has to. Here
 * signals are done one by one, modes beyond those of a process are skipped, and so are models that
 * do not count. _fast.py uses it if it could be built; numpy's is the one to read, and to test by.
 *
 * LANES amplitudes of a process are a group; its models lie side by side in all arrays. The last
 * group is rest, in the first of its lanes. Lanes that are no models have no chance: -infinity.
 */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define LANES 8
/* Derivatives by which samples are moved. */
#define SLOPES 4
/* Spectra there may be, and by how much evidence is too little to count. */
#define MOST_KINDS 8
#define FAR 80.0

/* Models of a window of `count` samples, as _fast.py packs them: see there for the arrays. */
typedef struct {
    long long count, half, processes, chunks, groups, kinds, exact, even, rows;
    const long long *first, *kind;
    const double *panels, *left, *share, *chances, *freedom;
    double known, least;
} Models;

typedef struct {
    long long orders;
    const double *modes, *spread;
} Stencils;

/* `summary` (2, 2, S) is the freedom and then the evidence of angle and position. */
typedef struct {
    double *mean, *covariance, *summary;
} Result;

/* The cells of one signal that count for less than 1, X of them: their modes (X, rows), `weight`
   (parts, X) and the roots of what these lack. There are two parts, angle and position, if their
   weights differ. */
typedef struct {
    long long number, parts;
    long long *at;
    double *modes, *weight, *root;
} Cells;

typedef struct {
    double total[3], whole[2];
    double *modes, *squares, *terms, *evidence, *variance, *likely, *weight, *apart, *mean, *spread;
    double *base, *off, *factors, *errors, *reach, *scaled, *along;
    long long *counts;
} Work;

static double
sum_of(const double *lanes)
{
    double sum = 0.0;
    for (int i = 0; i < LANES; i++)
        sum += lanes[i];
    return sum;
}

/* The modes of cells, and what is off at them (pairs + 3 X), of all but rest, and of rest, without
   the modes that are not mean and slope. */
static void
gather(const Models *m, const double *samples, long long bodies, const Cells *cells, Work *w)
{
    long long number = cells->number, k = 0, columns = number * (number + 1) / 2 + 3 * number;
    for (long long x = 0; x < number; x++) {
        long long at = cells->at[x], opposite = m->count - 1 - at;
        long long near = at < opposite ? at : opposite;
        for (long long r = 0; r < m->rows; r++) {
            double sign = r < m->even ? (at == opposite ? 2.0 : 1.0) : (at > opposite ? -1.0 : 1.0);
            const double *panel = m->panels + r / LANES * LANES * m->half;
            cells->modes[x * m->rows + r] = sign * panel[near * LANES + r % LANES];
        }
    }
    for (long long i = 0; i < number + 3; i++)
        for (long long j = 0; j < (i < number ? i + 1 : number); j++, k++) {
            const double *a = i < number ? cells->modes + i * m->rows
                                         : w->modes + (i - number) * m->rows;
            const double *b = cells->modes + j * m->rows;
            double all = i < number ? i == j : samples[(3 * cells->at[j] + i - number) * bodies];
            w->base[columns + k] = all - a[0] * b[0];
            w->base[k] = all - a[0] * b[0] - a[m->even] * b[m->even];
        }
}

/* What mean and slope, and of rest the mean, make of rows (number, rows) by stencils (orders,
   rows): (number, orders, LANES), or (orders, number, LANES) unless rows are outside. */
static void
line(const Models *m, const double *stencils, long long orders, const double *rows, long long number,
     long long group, double *out, int outside)
{
    for (long long j = 0; j < number; j++)
        for (long long k = 0; k < orders; k++) {
            const double *a = stencils + k * m->rows, *b = rows + j * m->rows;
            double value = a[0] * b[0] + (group < m->groups - 1 ? a[m->even] * b[m->even] : 0.0);
            for (int i = 0; i < LANES; i++)
                out[(outside ? j * orders + k : k * number + j) * LANES + i] = value;
        }
}

/* Probabilities and weights of models of the evidence, all (groups, LANES), as in _evidence.py, and
   the evidence of all of them together. */
static double
weigh(const Models *m, const double *evidence, double *likely, double *weight)
{
    long long models = m->groups * LANES;
    double best = -INFINITY, least = INFINITY, top[MOST_KINDS + 1], total[MOST_KINDS + 1] = {0};
    for (long long k = 0; k <= m->kinds; k++)
        top[k] = -INFINITY;
    for (long long i = 0; i < models; i++)
        if (evidence[i] > top[m->kind[i]])
            top[m->kind[i]] = evidence[i];
    /* The last kind is part of all others. */
    for (long long k = 0; k <= m->kinds; k++) {
        best = top[k] > best ? top[k] : best;
        top[k] = top[k] > top[m->kinds] ? top[k] : top[m->kinds];
        least = top[k] < least ? top[k] : least;
    }
    top[m->kinds] = least;
    /* NaN is to be seen, and not to be taken for models that do not count. */
    for (long long i = 0; i < models; i++) {
        weight[i] = evidence[i] < top[m->kind[i]] - FAR ? 0.0 : exp((evidence[i] - best) / 2);
        likely[i] = weight[i] * weight[i];
        total[m->kind[i]] += weight[i];
    }
    double common = 0.0, sum = 0.0, sure = 0.0;
    for (long long k = 0; k < m->kinds; k++) {
        total[k] += total[m->kinds];
        total[k] = total[k] > 1e-300 ? 1.0 / total[k] : 0.0;
        common += total[k];
    }
    total[m->kinds] = common;
    for (long long i = 0; i < models; i++)
        sum += weight[i] *= total[m->kind[i]];
    for (long long i = 0; i < models; i++) {
        weight[i] /= sum;
        if (weight[i] < m->least)
            weight[i] = likely[i] = 0.0;
        sure += likely[i];
    }
    for (long long i = 0; i < models; i++)
        likely[i] /= sure;
    return best + log(sure);
}

#define WIDTH 2
#define NAME(name) name##_anywhere
#include "_kernel_sums.h"
#undef NAME
#undef WIDTH
/* Not compiled for this very processor: a package may be built elsewhere. */
#if defined(__x86_64__) && (defined(__clang__) || defined(__GNUC__))
#define HAS_WIDE
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
#pragma GCC push_options
#pragma GCC target("avx2,fma")
#endif
#define WIDTH 4
#define NAME(name) name##_wide
#include "_kernel_sums.h"
#undef NAME
#ifdef __clang__
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif
#else
#define differentiate_wide differentiate_anywhere
#define move_wide move_anywhere
#endif

static int
is_wide(void)
{
#ifdef HAS_WIDE
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
    return 0;
#endif
}

/* Models of packed arrays. */
static void
unpack(const long long *head, const double *numbers, double known, double least, Models *m)
{
    m->count = head[0], m->processes = head[1], m->chunks = head[2], m->kinds = head[3];
    m->exact = head[4], m->even = head[5], m->rows = head[6];
    m->half = (m->count + 1) / 2, m->groups = m->processes * m->chunks + 1;
    m->known = known, m->least = least;
    m->first = head + 8, m->kind = m->first + 2 * (m->processes + 1);
    m->panels = numbers, numbers += m->rows * m->half;
    m->share = m->left = numbers, numbers += m->chunks * m->rows * LANES;
    if (m->exact)
        m->left = numbers, numbers += m->chunks * m->rows * LANES;
    m->chances = numbers, m->freedom = numbers + 2 * m->groups * LANES;
}

/* Arrays of the scratch, or how many numbers these are if there is none. */
static size_t
lay_out(const Models *m, long long orders, long long number, double *scratch, Work *w, Cells *cells)
{
    long long pairs = number * (number + 1) / 2, lanes = m->groups * LANES;
    long long columns = 3 * orders > 6 ? 3 * orders : 6;
    columns = pairs > columns ? pairs : columns;
    columns = (3 + orders) * number > columns ? (3 + orders) * number : columns;
    struct {
        double **array;
        size_t size;
    } arrays[] = {
        {&w->modes, 3 * m->rows},
        {&w->squares, 3 * m->rows},
        {&w->terms, columns * m->half},
        {&w->evidence, 2 * lanes},
        {&w->variance, 2 * lanes},
        {&w->likely, 2 * lanes},
        {&w->weight, 2 * lanes},
        {&w->apart, 3 * orders * lanes},
        {&w->mean, 3 * orders * LANES},
        {&w->spread, 2 * orders * orders * LANES},
        {&w->base, 2 * (pairs + 3 * number)},
        {&w->off, (pairs + 3 * number) * LANES},
        {&w->factors, 2 * pairs * lanes},
        {&w->errors, 3 * number * lanes},
        {&w->along, 2 * SLOPES * 3 * (m->half + LANES)},
        {&w->reach, orders * number * LANES},
        {&w->scaled, orders * number * LANES},
        {(double **)&w->counts, m->groups},
        {(double **)&cells->at, number},
        {&cells->modes, number * m->rows},
        {&cells->weight, 2 * number},
        {&cells->root, 2 * number},
    };
    size_t size = 0;
    for (size_t k = 0; k < sizeof arrays / sizeof *arrays; size += arrays[k++].size)
        if (scratch)
            *arrays[k].array = scratch + size;
    return size;
}

/* The cells (X,) of a signal that count for less than 1, and their weights (X, 2). */
static void
choose(const long long *at, const double *weight, long long number, long long bodies, Cells *cells)
{
    cells->number = 0, cells->parts = 1;
    for (long long x = 0; x < number; x++) {
        const double *own = weight + 2 * x * bodies;
        cells->number += own[0] < 1.0 || own[bodies] < 1.0;
        cells->parts += cells->parts == 1 && own[0] != own[bodies];
    }
    for (long long x = 0, k = 0; x < number; x++) {
        const double *own = weight + 2 * x * bodies;
        if (!(own[0] < 1.0 || own[bodies] < 1.0))
            continue;
        cells->at[k] = at[x * bodies];
        for (long long part = 0; part < cells->parts; part++) {
            cells->weight[part * cells->number + k] = own[part * bodies];
            cells->root[part * cells->number + k] = sqrt(1.0 - own[part * bodies]);
        }
        k++;
    }
}

/* Both get models, stencils or slopes, samples (n, 3, S), how many of them are seen (2, S), and cells
   (X, S) with weights (X, 2, S). Returns 0 if there is no memory for it. */
#define COMMON \
    double known, double least, const long long *counts, const double *numbers, \
    const double *tables, const double *samples, const double *seen, const long long *at, \
    const double *weight, long long number, long long bodies

int
kinpole_derive(COMMON, long long orders, double *mean, double *covariance, double *summary)
{
    Models m;
    Work w;
    Cells cells = {0};
    unpack(counts, numbers, known, least, &m);
    double *scratch = malloc(8 * lay_out(&m, orders, number, NULL, &w, &cells));
    Stencils s = {orders, tables, tables + orders * m.rows};
    int wide = is_wide();
    for (long long k = 0; scratch && k < bodies; k++) {
        Result out = {mean + k, covariance + k, summary + k};
        lay_out(&m, orders, number, scratch, &w, &cells);
        choose(at + k, weight + k, number, bodies, &cells);
        (wide ? differentiate_wide : differentiate_anywhere)(&m, &s, samples + k, bodies, seen + k,
                                                             &cells, &w, &out);
    }
    free(scratch);
    return scratch != NULL;
}

/* Samples that are moved from those `given`, which are `off` (n, S). */
int
kinpole_move(COMMON, const double *given, const double *off, double *moved)
{
    Models m;
    Work w;
    Cells cells = {0};
    unpack(counts, numbers, known, least, &m);
    double *scratch = malloc(8 * lay_out(&m, 1, number, NULL, &w, &cells));
    int wide = is_wide();
    for (long long k = 0; scratch && k < bodies; k++) {
        lay_out(&m, 1, number, scratch, &w, &cells);
        choose(at + k, weight + k, number, bodies, &cells);
        (wide ? move_wide : move_anywhere)(&m, tables, given + k, samples + k, off + k, bodies,
                                           seen + k, &cells, &w, moved + k);
    }
    free(scratch);
    return scratch != NULL;
}
