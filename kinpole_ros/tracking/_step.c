/*
 * The usual frame: poses fitted to markers, and poses that leave the path of their body found.
 *
 * Everything unusual is reported to tracker.py, which decides and calls again. Arrays are those of
 * History and Bodies; names and shapes are given there. All are row-major.
 */

#include <math.h>

#include "_frames.h"

#pragma GCC optimize("O3", "cx-limited-range")

enum { LONGEST = 3, LOOK_BACK = 4 * LONGEST, NODES = 4 };
static const double ROUNDING = 4 * 2.220446049250313e-16, TINY = 2.2250738585072014e-308;
static const double TURN = 6.283185307179586;

/* An angle in [-pi, pi]. */
static double
wrapped(Number angle)
{
    return creal(angle) - TURN * rint(creal(angle) / TURN);
}

/* Fits the pose of body `b` to its markers (n,), and writes the newest row; what is unusual. */
static int
fit(const Frames *f, long long b, const Number *points, int goes_on)
{
    long long n = f->width, newest = f->end - 1, at = newest * f->bodies + b;
    const Number *shape = f->shape + b * n;
    const double *weights = f->weights + b * n;
    Number *residual = f->residual + at * n, middle = 0.0, mean = 0.0, cross = 0.0;
    double total = 0.0, spread = 0.0, reach = 0.0, own_reach = 0.0;
    int found = 0;
    for (long long k = 0; k < n; k++)
        if (weights[k] > 0.0 && !isnan(creal(points[k])) && !isnan(cimag(points[k]))) {
            total += weights[k];
            middle += weights[k] * points[k];
            mean += weights[k] * shape[k];
            f->used[at * n + k] = 1;
        } else {
            f->used[at * n + k] = 0;
            found |= weights[k] > 0.0 || isnan(creal(points[k])) ? 0 : NEW_MARKER;
        }
    middle /= total, mean /= total;
    for (long long k = 0; k < n; k++)
        if (f->used[at * n + k]) {
            Number arm = points[k] - middle, own = shape[k] - mean;
            double square = square_of(own), far = square_of(arm);
            cross += weights[k] * conj(own) * arm;
            spread += weights[k] * square;
            reach = far > reach ? far : reach, own_reach = square > own_reach ? square : own_reach;
        }
    double length = cabs(cross);
    int fits = length > TINY && sqrt(reach) > ROUNDING * cabs(middle) &&
        sqrt(own_reach) > ROUNDING * cabs(mean);
    Number turn = fits ? cross / length : NAN;
    double angle = fits ? atan2(cimag(turn), creal(turn)) : NAN;
    for (long long k = 0; k < n; k++) {
        if (!f->used[at * n + k] || !fits) {
            f->used[at * n + k] = 0, residual[k] = NAN + NAN * I;
            continue;
        }
        residual[k] = (points[k] - middle) * conj(turn) - (shape[k] - mean);
        double square = square_of(residual[k]);
        found |= (square > f->largest[b * n + k] ? ODD : 0);
        found |= (square > f->doubtful[b * n + k] ? NAME_DOUBTFUL : 0);
    }
    if (goes_on && newest > f->first && cos(angle - f->angle[at - f->bodies]) < 0.0)
        found |= ODD;
    /* Of markers too close together for their noise, while others of the body are hidden. */
    int known = fits && !(f->spread[b] > f->loosest[b] && spread < f->loosest[b]);
    f->angle[at] = known ? angle : NAN;
    f->position[at] = known ? middle - turn * mean : NAN;
    double *information = f->information + 2 * newest * f->bodies + b;
    information[0] = !known ? 0.0 : f->posed ? 1.0 : spread;
    information[f->bodies] = !known ? 0.0 : f->posed ? 1.0 :
        1.0 / (1.0 / total + square_of(mean) / spread);
    return found;
}

/* Counts the whole turns of the newest angles from the last ones that were known. */
static void
unwrap(const Frames *f)
{
    for (long long b = 0; b < f->bodies; b++) {
        long long at = (f->end - 1) * f->bodies + b;
        double turns = f->end - 1 > f->first ? f->turns[at - f->bodies] : 0.0;
        double angle = f->angle[at], last = f->last_angle[b];
        if (!isnan(angle)) {
            turns -= isnan(last) ? 0.0 : rint((angle - last) / TURN);
            f->last_angle[b] = angle;
        }
        f->turns[at] = turns;
    }
}

/* Fits a frame of markers (B, n) into the newest row; what is unusual of any body. */
int
kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on)
{
    int found = 0;
    for (long long b = 0; b < f->bodies; b++)
        found |= f->unusual[b] = fit(f, b, markers + b * f->width, goes_on);
    return found;
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
    long long newest = f->end - 1, begin = newest - LOOK_BACK + 1;
    begin = begin < f->first ? f->first : begin;
    long long rows[LOOK_BACK];
    int count = 0;
    for (long long row = newest; row >= begin && count < LONGEST + NODES; row--)
        if (f->information[2 * row * f->bodies + b] > 0.0)
            rows[count++] = row;
    path->count = count;
    if (count < 5 || rows[0] != newest)
        return 0;
    for (int k = 0; k < count; k++) {
        long long row = rows[count - 1 - k], at = row * f->bodies + b;
        path->row[k] = row;
        path->time[k] = (f->time[row] - f->time[newest]) * 1e-9;
        path->value[0][k] = f->angle[at] + TURN * f->turns[at];
        path->value[1][k] = f->position[at];
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
        p->value[0][last - 1] -= (more - *turns) * TURN, p->value[0][last] -= (more - *turns) * TURN;
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
                Number slope = (p->value[s][node[1]] - p->value[s][node[0]]) / (nodes[1] - nodes[0]);
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

/* Completes the newest row. Poses that it shows to be wrong get no information, and are added to
   `wrong` (B,); `newest` (B,) gets how many of the newest cannot be told from wrong ones yet. */
void
kinpole_follow_paths(const Frames *f)
{
    long long *wrong = f->wrong, *newest = f->newest;
    unwrap(f);
    for (long long b = 0; b < f->bodies; b++) {
        double least[2] = {f->near, f->near * f->size[b]}, most[2], more[2];
        Path path;
        newest[b] = 0;
        if (!(isfinite(f->jump_scale[b]) && isfinite(f->jump_scale[f->bodies + b])) ||
            !path_of(f, b, &path))
            continue;
        for (int s = 0; s < 2; s++) {
            most[s] = f->far * f->jump_scale[s * f->bodies + b];
            more[s] = f->newest_factor * most[s] > least[s] ? f->newest_factor * most[s] : least[s];
        }
        double turns;
        int length = wrong_before_last(&path, most, least, &turns);
        for (int k = path.count - 2; k < path.count; k++)
            f->turns[path.row[k] * f->bodies + b] -= turns;
        for (int k = path.count - 2 - length; k < path.count - 2; k++) {
            double *information = f->information + 2 * path.row[k] * f->bodies + b;
            information[0] = information[f->bodies] = 0.0;
        }
        wrong[b] += length;
        if (length && !path_of(f, b, &path))
            continue;
        newest[b] = doubtful_newest(&path, more);
    }
}
