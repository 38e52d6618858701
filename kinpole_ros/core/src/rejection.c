/*
 * Which poses are not used, and why: poses off the path of their body, and off its pin.
 *
 * A path is two signals: s = 0 is the angle, rad, with its whole turns, and s = 1 the position, m.
 * A pose is off the path if it is off a polynomial through its neighbors by more than their noise
 * and a least distance allow. Nodes are the poses that a polynomial goes through.
 */

#include <math.h>

#include "numbers.h"
#include "rejection.h"

/* Wrong poses in a row that are found at most; rows that are searched for poses; nodes of a cubic;
   poses of a path, and the fewest that show one wrong. */
enum { LONGEST = 3, LOOK_BACK = 4 * LONGEST, NODES = 4, PATH_POSES = LONGEST + NODES, FEWEST = 5 };
/* Poses off a pin in a window that are outliers at most. */
enum { MAX_OFF_PIN = 2 };

/* The size of a difference `off` of signal `s`, rad or m, without whole turns of the angle. */
static double
distance_of(int s, Number off)
{
    return s ? cabs(off) : fabs(creal(off) - TURN * rint(creal(off) / TURN));
}

/* Writes the `weights` (count) of the values at times `nodes` (count) in the polynomial through
   them, at the time `at`, all in s. Returns the noise ratio: the standard deviation of a value
   there less that polynomial, over that of a value. */
static double
lagrange(const double *nodes, int count, double at, double *weights)
{
    double square = 1.0;
    for (int i = 0; i < count; i++) {
        weights[i] = 1.0;
        for (int j = 0; j < count; j++)
            if (j != i)
                weights[i] *= (at - nodes[j]) / (nodes[i] - nodes[j]);
        square += weights[i] * weights[i];
    }
    return sqrt(square);
}

/* The last poses of a body that are used, oldest first. */
typedef struct {
    int count;
    double time[PATH_POSES];     /* s, after the newest row, so 0 or less */
    long long row[PATH_POSES];   /* of the history */
    Number value[2][PATH_POSES]; /* both signals, rad with its turns and m */
} Path;

/* Reads the path of body `b`. Returns 0 if there are fewer than FEWEST poses, or the newest row has
   none. */
static int
path_of(const Frames *f, long long b, Path *path)
{
    const HistoryColumns *history = &f->history;
    long long newest = history->end - 1, begin = newest - LOOK_BACK + 1;
    begin = begin < history->first ? history->first : begin;
    long long rows[LOOK_BACK];
    int count = 0;
    for (long long row = newest; row >= begin && count < PATH_POSES; row--)
        if (history->information[2 * row * f->known.bodies + b] > 0.0)
            rows[count++] = row;
    path->count = count;
    if (count < FEWEST || rows[0] != newest)
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

/* Writes to `distance` (2), rad and m, how far pose `k` of a path is off the cubic through the
   poses `node` (NODES), whose values have the `weights` (NODES) of `lagrange` at the time of pose
   `k`. */
static void
distances_from_cubic(const Path *p, int k, const int *node, const double *weights, double *distance)
{
    for (int s = 0; s < 2; s++) {
        Number off = p->value[s][k];
        for (int j = 0; j < NODES; j++)
            off -= weights[j] * p->value[s][node[j]];
        distance[s] = distance_of(s, off);
    }
}

/* Whether the poses after a gap go on from those before it: each is nearer than `smallest` (2), rad
   and m, to the line through the two before, in the signals in which `all` (2) poses of the gap are
   off. After a jump that lasts they do not. `node` (NODES) are two poses before the gap and two
   after it, and `nodes` (NODES) their times, s. */
static int
goes_back(const Path *p, const int *node, const double *nodes, const int *all,
          const double *smallest)
{
    int back = 1;
    for (int s = 0; s < 2; s++)
        for (int k = 2; k < NODES && all[s]; k++) {
            Number slope = p->value[s][node[1]] - p->value[s][node[0]];
            slope /= nodes[1] - nodes[0];
            Number ahead = p->value[s][node[1]] + slope * (nodes[k] - nodes[1]);
            back &= cabs(p->value[s][node[k]] - ahead) < smallest[s];
        }
    return back;
}

/* Returns how many poses before the last two are off the cubic through the two before and the two
   after, by more than `most` (2), rad and m, times the noise ratio, and by more than `least` (2),
   rad and m. Writes by how many `turns` too many the last two were counted while the wrong poses
   were followed; 0 if no pose is wrong. */
static int
wrong_before_last(const Path *path, const double *most, const double *least, double *turns)
{
    int last = path->count - 1;
    Path trial = *path;
    *turns = 0.0;
    for (int length = LONGEST; length > 0; length--) {
        if (length + NODES > path->count)
            continue;
        int gap = last - 1 - length, every = 1, all[2] = {1, 1};
        int node[NODES] = {gap - 2, gap - 1, last - 1, last};
        double nodes[NODES], weights[NODES], smallest[2] = {INFINITY, INFINITY};
        for (int k = 0; k < NODES; k++)
            nodes[k] = path->time[node[k]];
        Number step = (path->value[0][node[1]] - path->value[0][node[0]]) / (nodes[1] - nodes[0]);
        Number there = path->value[0][node[1]] + step * (nodes[2] - nodes[1]);
        /* Those beyond the turns of the longer gap that was tried before. */
        double more = rint(creal(trial.value[0][last - 1] - there) / TURN);
        trial.value[0][last - 1] -= (more - *turns) * TURN;
        trial.value[0][last] -= (more - *turns) * TURN;
        *turns = more;
        for (int k = gap; k < gap + length; k++) {
            double distance[2], noise_ratio = lagrange(nodes, NODES, path->time[k], weights);
            int any = 0;
            distances_from_cubic(&trial, k, node, weights, distance);
            for (int s = 0; s < 2; s++) {
                int far = distance[s] > larger(most[s] * noise_ratio, least[s]);
                any |= far;
                all[s] &= far;
                smallest[s] = smaller(distance[s], smallest[s]);
            }
            every &= any;
        }
        if (every && goes_back(&trial, node, nodes, all, smallest))
            return length;
    }
    *turns = 0.0;
    return 0;
}

/* Returns the number of newest frames from the first one whose pose is farther than `most` (2), rad
   and m, times the noise ratio off all polynomials through up to NODES poses before it; 0 if there
   is none among the last LONGEST. */
static int
doubtful_newest(const Path *p, const double *most)
{
    int begin = p->count - LONGEST > NODES ? p->count - LONGEST : NODES;
    for (int k = begin; k < p->count; k++) {
        double least[2] = {INFINITY, INFINITY}, weights[NODES];
        for (int used = 1; used <= NODES; used++) {
            double noise_ratio = lagrange(p->time + k - used, used, p->time[k], weights);
            for (int s = 0; s < 2; s++) {
                Number off = p->value[s][k];
                for (int j = 0; j < used; j++)
                    off -= weights[j] * p->value[s][k - used + j];
                least[s] = smaller(distance_of(s, off) / noise_ratio, least[s]);
            }
        }
        if (least[0] > most[0] || least[1] > most[1])
            return p->row[p->count - 1] - p->row[k] + 1;
    }
    return 0;
}

void
kinpole_follow_paths(const Frames *f)
{
    const BodyArrays *known = &f->known;
    const FrameLimits *limits = &f->limits;
    long long *left_out = f->tracks.left_out;
    for (long long b = 0; b < known->bodies; b++) {
        double least[2] = {limits->near, limits->near * known->size[b]}, most[2], more[2];
        Path path;
        left_out[b] = 0;
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
        f->tracks.wrong[b] += length;
        if (length && !path_of(f, b, &path))
            continue;
        left_out[b] = doubtful_newest(&path, more);
    }
}

/* Whether marker `k` of `points` (n), m, of body `b` repeats that of the row `rows_before` the
   newest to the last bit; 0 if there is no such row. */
static int
repeats(const Frames *f, long long b, const Number *points, long long k, long long rows_before)
{
    const HistoryColumns *history = &f->history;
    long long row = history->end - 1 - rows_before;
    return row >= history->first &&
        points[k] == history->markers[(row * f->known.bodies + b) * f->known.width + k];
}

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

int
kinpole_is_marker_held(const Frames *f, long long b, const Number *points, long long k)
{
    return f->known.repetition[b] == NO_MARKER_REPEATS && repeats(f, b, points, k, 1) &&
        repeats(f, b, points, k, 2);
}

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
        double angle_variance = known->marker_variance[b] / (information[0] * factor[0]);
        double position_variance =
            known->marker_variance[b] / (information[known->bodies] * factor[known->bodies]);
        Number turn = cos(history->angle[at]) + I * sin(history->angle[at]);
        double square = square_of(history->position[at] + turn * known->pin_arm[b] - known->pin[b]);
        double variance = position_variance + square_of(known->pin_arm[b]) * angle_variance;
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
