/*
 * Which poses are not used, and why: poses off the path of their body, and off its pin.
 */

#include <math.h>

#include "numbers.h"
#include "rejection.h"

enum { LONGEST = 3, LOOK_BACK = 4 * LONGEST, NODES = 4 };
/* Poses off a pin in a window that are outliers at most. */
enum { MAX_OFF_PIN = 2 };

/* An angle in [-pi, pi]. */
static double
wrapped(Number angle)
{
    return creal(angle) - TURN * rint(creal(angle) / TURN);
}

/* Weights of values at nodes in the polynomial through them, at a time; the gain of white noise. */
static double
lagrange(const double *nodes, int count, double at, double *weights)
{
    double gain = 1.0;
    for (int i = 0; i < count; i++) {
        weights[i] = 1.0;
        for (int j = 0; j < count; j++)
            if (j != i)
                weights[i] *= (at - nodes[j]) / (nodes[i] - nodes[j]);
        gain += weights[i] * weights[i];
    }
    return sqrt(gain);
}

/* The last poses of a body, oldest first: times, s, rows, and both signals. */
typedef struct {
    int count;
    double time[LONGEST + NODES];
    long long row[LONGEST + NODES];
    Number value[2][LONGEST + NODES];
} Path;

static int
path_of(const Frames *f, long long b, Path *path)
{
    const HistoryColumns *history = &f->history;
    long long newest = history->end - 1, begin = newest - LOOK_BACK + 1;
    begin = begin < history->first ? history->first : begin;
    long long rows[LOOK_BACK];
    int count = 0;
    for (long long row = newest; row >= begin && count < LONGEST + NODES; row--)
        if (history->information[2 * row * f->known.bodies + b] > 0.0)
            rows[count++] = row;
    path->count = count;
    if (count < 5 || rows[0] != newest)
        return 0;
    for (int k = 0; k < count; k++) {
        long long row = rows[count - 1 - k], at = row * f->known.bodies + b;
        path->row[k] = row;
        path->time[k] = (history->time[row] - history->time[newest]) * 1e-9;
        path->value[0][k] = history->angle[at] + TURN * history->turns[at];
        path->value[1][k] = history->position[at];
    }
    return 1;
}

/* How many poses before the last two are off the cubic through the two before and the two after.
   While they were followed, the angles after may have been taken for `turns` more. */
static int
wrong_before_last(Path *p, const double *most, const double *least, double *turns)
{
    int last = p->count - 1;
    *turns = 0.0;
    for (int length = LONGEST; length > 0; length--) {
        if (length + NODES > p->count)
            continue;
        int gap = p->count - 2 - length;
        int node[NODES] = {gap - 2, gap - 1, p->count - 2, p->count - 1};
        double nodes[NODES], weights[NODES], smallest[2] = {INFINITY, INFINITY};
        int every = 1, all[2] = {1, 1};
        for (int k = 0; k < NODES; k++)
            nodes[k] = p->time[node[k]];
        Number step = (p->value[0][node[1]] - p->value[0][node[0]]) / (nodes[1] - nodes[0]);
        Number there = p->value[0][node[1]] + step * (nodes[2] - nodes[1]);
        double more = rint(creal(p->value[0][last - 1] - there) / TURN);
        p->value[0][last - 1] -= (more - *turns) * TURN;
        p->value[0][last] -= (more - *turns) * TURN;
        *turns = more;
        for (int k = gap; k < gap + length; k++) {
            double gain = lagrange(nodes, NODES, p->time[k], weights);
            int any = 0;
            for (int s = 0; s < 2; s++) {
                Number off = p->value[s][k];
                for (int j = 0; j < NODES; j++)
                    off -= weights[j] * p->value[s][node[j]];
                double limit = most[s] * gain, distance = s ? cabs(off) : fabs(wrapped(off));
                int far = distance > (limit > least[s] ? limit : least[s]);
                any |= far, all[s] &= far;
                smallest[s] = distance < smallest[s] ? distance : smallest[s];
            }
            every &= any;
        }
        if (!every)
            continue;
        /* After a jump that lasts, the poses after do not go on from those before. */
        int back = 1;
        for (int s = 0; s < 2; s++)
            for (int k = 2; k < NODES && all[s]; k++) {
                Number slope = p->value[s][node[1]] - p->value[s][node[0]];
                slope /= nodes[1] - nodes[0];
                Number ahead = p->value[s][node[1]] + slope * (nodes[k] - nodes[1]);
                back &= cabs(p->value[s][node[k]] - ahead) < smallest[s];
            }
        if (back)
            return length;
    }
    p->value[0][last - 1] += *turns * TURN, p->value[0][last] += *turns * TURN;
    *turns = 0.0;
    return 0;
}

/* Of how many of the last poses the first is far off all polynomials through those before it. */
static int
doubtful_newest(const Path *p, const double *most)
{
    int begin = p->count - LONGEST > NODES ? p->count - LONGEST : NODES;
    for (int k = begin; k < p->count; k++) {
        double least[2] = {INFINITY, INFINITY}, weights[NODES];
        for (int used = 1; used <= NODES; used++) {
            double gain = lagrange(p->time + k - used, used, p->time[k], weights);
            for (int s = 0; s < 2; s++) {
                Number off = p->value[s][k];
                for (int j = 0; j < used; j++)
                    off -= weights[j] * p->value[s][k - used + j];
                double distance = (s ? cabs(off) : fabs(wrapped(off))) / gain;
                least[s] = distance < least[s] ? distance : least[s];
            }
        }
        if (least[0] > most[0] || least[1] > most[1])
            return p->row[p->count - 1] - p->row[k] + 1;
    }
    return 0;
}

/* Poses that the newest row shows to be wrong get no information, and are added to `wrong` (B,);
   `newest` (B,) gets how many of the newest cannot be told from wrong ones yet. */
void
kinpole_follow_paths(const Frames *f)
{
    const BodyArrays *known = &f->known;
    const FrameLimits *limits = &f->limits;
    long long *wrong = f->tracks.wrong, *newest = f->tracks.left_out;
    for (long long b = 0; b < known->bodies; b++) {
        double least[2] = {limits->near, limits->near * known->size[b]}, most[2], more[2];
        Path path;
        newest[b] = 0;
        if (!(isfinite(known->jump_scale[b]) && isfinite(known->jump_scale[known->bodies + b])) ||
            !path_of(f, b, &path))
            continue;
        for (int s = 0; s < 2; s++) {
            most[s] = limits->far * known->jump_scale[s * known->bodies + b];
            more[s] = larger(limits->newest_factor * most[s], least[s]);
        }
        double turns;
        int length = wrong_before_last(&path, most, least, &turns);
        for (int k = path.count - 2; k < path.count; k++)
            f->history.turns[path.row[k] * known->bodies + b] -= turns;
        for (int k = path.count - 2 - length; k < path.count - 2; k++) {
            double *information = f->history.information + 2 * path.row[k] * known->bodies + b;
            information[0] = information[known->bodies] = 0.0;
        }
        wrong[b] += length;
        if (length && !path_of(f, b, &path))
            continue;
        newest[b] = doubtful_newest(&path, more);
    }
}

/* Whether marker k of the markers (n,) of a body repeats that of an earlier row to the last bit. */
static int
repeats(const Frames *f, long long b, const Number *points, long long k, long long rows_before)
{
    const HistoryColumns *history = &f->history;
    long long row = history->end - 1 - rows_before;
    return row >= history->first &&
        points[k] == history->markers[(row * f->known.bodies + b) * f->known.width + k];
}

/* Whether the markers (n,) of a body repeat those of the row before to the last bit, while measured
   ones never do: the tracker holds the last pose of a body that it has lost. */
int
kinpole_is_held(const Frames *f, long long b, const Number *points)
{
    long long seen = 0;
    if (f->known.repetition[b] == MAY_REPEAT)
        return 0;
    for (long long k = 0; k < f->known.width; k++) {
        if (isnan(creal(points[k])))
            continue;
        if (!repeats(f, b, points, k, 1))
            return 0;
        seen++;
    }
    return seen > 1;
}

/* Whether one marker repeats those of two rows before, which no measured marker of the body ever
   does: it is lost, and its last place or a constant stands for it. */
int
kinpole_is_marker_held(const Frames *f, long long b, const Number *points, long long k)
{
    return f->known.repetition[b] == NO_MARKER_REPEATS && repeats(f, b, points, k, 1) &&
        repeats(f, b, points, k, 2);
}

/* Whether a body was on its pin in all frames of the window but two at most. */
int
kinpole_holds_on_pin(const Frames *f, long long oldest, long long b)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    if (!(isfinite(creal(known->pin[b])) && known->pin_since[b] <= history->time[oldest]))
        return 0;
    int off = 0;
    for (long long row = oldest; row < history->end; row++) {
        const double *information = history->information + 2 * row * known->bodies + b;
        if (!(information[0] > 0.0 && information[known->bodies] > 0.0))
            continue;
        long long at = row * known->bodies + b;
        const double *factor = known->information_factor + b;
        double turned = known->error[b] / (information[0] * factor[0]);
        double placed =
            known->error[b] / (information[known->bodies] * factor[known->bodies]);
        Number turn = cos(history->angle[at]) + I * sin(history->angle[at]);
        double square = square_of(history->position[at] + turn * known->pin_arm[b] - known->pin[b]);
        double variance = placed + square_of(known->pin_arm[b]) * turned;
        off += square > f->limits.n_sigma * f->limits.n_sigma * variance;
    }
    return off <= MAX_OFF_PIN;
}

int
kinpole_reason(const Frames *f, long long now, long long b)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->known;
    const double *information = history->information + 2 * now * known->bodies + b;
    int seen = information[0] > 0.0 && information[known->bodies] > 0.0 &&
        now < history->end - f->tracks.left_out[b];
    if (seen)
        return known->reason[b];
    return isnan(history->angle[now * known->bodies + b]) ? NOT_SEEN : OFF_PATH;
}
