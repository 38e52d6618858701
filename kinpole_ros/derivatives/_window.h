/*
 * From poses at stamps to samples in even cells.
 *
 * A window is cut into cells as long as the usual interval between frames. Cells may be empty, good
 * for less than others, or not where their frame is; too many of them are averaged in blocks.
 */

/* Samples of the shortest window there is; it still has every order. */
#define FEWEST_SAMPLES 7
/* More samples than this in a window are averaged in blocks. */
#define MOST_SAMPLES 128
/* Samples with this share of the information of the best count equally, by their mean. */
#define SIMILAR 0.5
/* Samples of a block with less than this share of the information of the best are left out. */
#define POOR 0.25
/* A sample is in its place if it is off by less than this part of the interval. */
#define OFF 1e-4
/* A gap that is off a whole number of intervals by more than this makes their count doubtful. */
#define DOUBTFUL 0.2
/* If the count is doubtful, up to so many intervals more and fewer are tried. */
#define MISCOUNTED 4
/* Cells of a window, most of which are empty where frames come in bunches: a bound of memory. */
#define MOST_CELLS 4096
/* Samples that differ by more deviations of their noise are taken for exact. */
#define EXACT 1e7
/* Samples differ by no more deviations of their noise, or the noise is taken for larger. */
#define MOST_EXACT 1e13
/* At least this part of a window has to be seen. */
#define PRESENT 0.5
/* A window that is not full is at most so much larger than what there is of it. */
#define LARGER 1.25
/* If more cells than that are lacking, two of them make one: cost goes by the square. */
#define MOST_LACKING 24
/* A sample that is missing is first put on a parabola through so many others. */
#define NEAREST 6
/* Samples are moved to their places at most so often, and up to 3 times more. */
#define ROUNDS 6
/* Samples that are all but exact are moved at most so often, and up to 3 times more. */
#define MORE_ROUNDS 38
/* Samples that move by less than so many deviations are in their places. */
#define SETTLED 0.05
/* While samples are moved the noise counts for so many samples: it is more than was measured. */
#define KNOWN_MEANWHILE 1.0

#include "_call.h"

/* The even cells of an instant: the interval, ns, and of each frame, the newest first, its cell and
   by how many intervals it is late. */
typedef struct {
    double interval, *late;
    long long *cell;
} Grid;

/* A buffer of a thread that lives as long as it does. */
enum { OF_GRID, OF_CELLS, OF_WINDOW, OF_MODELS, OF_SETS, BUFFERS };
static void *
buffer(int which, size_t size)
{
    static _Thread_local struct {
        void *data;
        size_t size;
    } all[BUFFERS];
    if (size > all[which].size) {
        free(all[which].data);
        all[which].data = malloc(size);
        all[which].size = all[which].data ? size : 0;
    }
    return all[which].data;
}

static int
compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The interval by which frames are nearest to even places, with about so many in the span. */
static double
clearest_interval(const double *time, long long frames, double span, double intervals)
{
    double best = -1.0, number = 1.0, x = 0.0, y = 0.0;
    for (int more = -MISCOUNTED; more <= MISCOUNTED; more++) {
        double tried = larger(intervals + more, 1.0), real = 0.0, imaginary = 0.0;
        for (long long k = 0; k < frames; k++) {
            double turn = 2 * M_PI * time[k] / span * tried;
            real += cos(turn), imaginary += sin(turn);
        }
        double length = hypot(real, imaginary);
        if (length > best)
            best = length, number = tried, x = real, y = imaginary;
    }
    /* The ends of the span are as late as any other frame. */
    double interval = span / number, phase = atan2(y, x) / (2 * M_PI), middle = 0.0;
    double along = 0.0, square = 0.0;
    for (long long k = 0; k < frames; k++)
        middle += time[k] / interval / frames;
    for (long long k = 0; k < frames; k++) {
        double place = time[k] / interval, off = place - phase, distance = place - middle;
        off -= rint(off);
        along += distance * off, square += distance * distance;
    }
    return interval * (1 + along / larger(square, 1e-300));
}

/* The grid of an instant with so many frames in its window, the newest of which is `newest`. */
static int
find_grid(const long long *stamps, long long now, long long newest, long long frames, Grid *grid)
{
    double *time = buffer(OF_GRID, frames * 4 * sizeof(double));
    if (!time)
        return NO_MEMORY;
    double *steps = time + frames;
    grid->late = steps + frames, grid->cell = (long long *)(grid->late + frames);
    for (long long k = 0; k < frames; k++)
        time[k] = stamps[newest - k] - stamps[now];
    double span = time[0] - time[frames - 1];
    grid->interval = span / (frames - 1);
    int even = 1;
    for (long long k = 0; k < frames; k++) {
        grid->cell[k] = newest - now - k, grid->late[k] = 0.0;
        even &= fabs(time[k] - grid->cell[k] * grid->interval) <= OFF * grid->interval;
    }
    if (even)
        return DONE;
    for (long long k = 0; k < frames - 1; k++)
        steps[k] = time[k] - time[k + 1];
    qsort(steps, frames - 1, sizeof(double), compare);
    /* Most frames may come in bunches, with next to nothing between them. */
    double usual = larger(steps[(frames - 2) / 2], span / MOST_CELLS), intervals = 0.0;
    int doubtful = 0;
    for (long long k = 0; k < frames - 1; k++) {
        double number = rint(steps[k] / usual);
        intervals += number;
        doubtful |= fabs(steps[k] / usual - number) > DOUBTFUL;
    }
    intervals = larger(intervals, 1.0);
    grid->interval = doubtful ? clearest_interval(time, frames, span, intervals) : span / intervals;
    /* About where frames are on the mean: about themselves two might have the same cell. */
    double x = 0.0, y = 0.0;
    for (long long k = 0; k < frames; k++) {
        double turn = 2 * M_PI * (time[k] / grid->interval);
        x += cos(turn), y += sin(turn);
    }
    double phase = atan2(y, x) / (2 * M_PI);
    for (long long k = 0; k < frames; k++) {
        double place = time[k] / grid->interval;
        grid->cell[k] = (long long)(rint(place - phase) - rint(-phase));
        double late = place - grid->cell[k];
        grid->late[k] = fabs(late) < OFF ? 0.0 : late;
    }
    return DONE;
}

/* The mean of the numbers that are at least SIMILAR times the largest. */
static double
usual_of(const double *information, long long count)
{
    double best = 0.0, sum = 0.0, number = 0.0;
    for (long long k = 0; k < count; k++)
        best = larger(best, information[k]);
    for (long long k = 0; k < count; k++)
        if (information[k] >= SIMILAR * best)
            sum += information[k], number += 1.0;
    return sum / number;
}

/* Weights over the usual information; those that are similar are 1. */
static void
make_weights(double *weight, long long count, double usual)
{
    for (long long k = 0; k < count; k++) {
        weight[k] = usual > 0 ? weight[k] / usual : 0.0;
        weight[k] = weight[k] >= SIMILAR ? 1.0 : weight[k];
    }
}

/* Room for so many samples, or 0. */
static int
make_room(Samples *s, int which, long long count)
{
    double *data = buffer(which, 6 * count * sizeof(double));
    if (!data)
        return 0;
    memset(data, 0, 6 * count * sizeof(double));
    s->count = count;
    for (int c = 0; c < 3; c++)
        s->x[c] = data + c * count;
    s->weight[0] = data + 3 * count, s->weight[1] = data + 4 * count, s->off = data + 5 * count;
    return 1;
}

/* Divide the samples of angle and position by a number each. */
static void
divide(const Samples *s, const double *by)
{
    for (int c = 0; c < 3; c++)
        for (long long k = 0; k < s->count; k++)
            s->x[c][k] /= by[c > 0];
}

/* The largest sample of the angle, or of the position. */
static double
largest_of(const Samples *s, int c)
{
    double most = 0.0;
    for (int d = c; d <= 2 * c; d++)
        for (long long k = 0; k < s->count; k++)
            most = larger(most, fabs(s->x[d][k]));
    return most;
}

/* Fill the cells of one body, the newest first, relative to its pose at the instant and in units of
   the noise. `count` is the number of cells, 0 if too few, and `ahead` how many are newer than the
   instant; empty cells follow. `exact` says that the motion is far larger than its noise. */
static int
fill_cells(const Call *call, long long instant, long long body, const Grid *grid, Samples *s,
           long long *count, long long *ahead, double *unit, int *exact)
{
    const long long *windows = call->windows + instant, bodies = call->bodies;
    long long now = windows[0] * bodies + body, newest = windows[2 * call->instants];
    long long frames = newest - windows[call->instants] + 1, signal = instant * bodies + body;
    long long oldest = 0;
    *ahead = -1, *count = 0;
    for (int pass = 0; pass < 2; pass++) {
        double a = call->angle[now], turns = call->turns[now];
        double x = call->position[2 * now], y = call->position[2 * now + 1];
        /* Where the body is not seen at the instant, about nothing. */
        if (isnan(a))
            a = turns = x = y = 0.0;
        for (long long k = call->left_out[signal]; k < frames; k++) {
            long long row = (newest - k) * bodies + body, cell = grid->cell[k], at = *ahead - cell;
            if (!(call->angle_information[row] > 0 && call->position_information[row] > 0))
                continue;
            if (pass) {
                s->x[0][at] = call->angle[row] - a + 2 * M_PI * (call->turns[row] - turns);
                s->x[1][at] = call->position[2 * row] - x;
                s->x[2][at] = call->position[2 * row + 1] - y;
                s->weight[0][at] = call->angle_information[row];
                s->weight[1][at] = call->position_information[row];
                s->off[at] = grid->late[k];
            } else {
                oldest = *count == 0 || cell < oldest ? cell : oldest;
                *ahead = *count == 0 || cell > *ahead ? cell : *ahead;
                *count = *ahead - oldest + 1;
            }
        }
        if (*count < FEWEST_SAMPLES)
            *count = 0;
        else if (!pass && !make_room(s, OF_CELLS, (long long)(LARGER * *count) + 1))
            return NO_MEMORY;
        if (!*count)
            return DONE;
    }
    for (int c = 0; c < 2; c++) {
        double most = largest_of(s, c), usual = usual_of(s->weight[c], *count);
        /* There is no noise below rounding. */
        unit[c] = larger(call->noise[signal] / sqrt(usual), most / MOST_EXACT);
        *exact |= most > EXACT * unit[c];
        make_weights(s->weight[c], *count, usual);
    }
    divide(s, unit);
    return DONE;
}

/* Choose the number of blocks of a window of which enough is seen, or 0. It has `full` blocks if it
   is full, the oldest sample is in block `last`, and `ahead` are newer than the instant. `seen`
   counts the blocks with samples up to each. */
static long long
find_size(long long full, long long last, long long ahead, int exact, const long long *seen,
          long long blocks)
{
    /* Windows that are not full have few sizes, since models of each take time to make. */
    long long sizes[32] = {FEWEST_SAMPLES}, number = 1, there = full < last ? full : last;
    while ((long long)(sizes[number - 1] * LARGER) <= MOST_SAMPLES)
        sizes[number] = (long long)(sizes[number - 1] * LARGER), number++;
    /* Where stamps are not even a window has one frame more or less. */
    long long most = last == full - 1 ? last : full;
    for (long long k = number; k >= -1; most = k > 0 ? sizes[k - 1] : full, k--) {
        /* At last, if the instant is the oldest of it. */
        long long size = exact || k < 0 ? there : most < full ? most : full;
        if (k >= 0 && size > LARGER * last)
            continue;
        if (size < FEWEST_SAMPLES || size <= ahead)
            continue;
        double here = seen[(size < blocks ? size : blocks) - 1];
        if (here >= FEWEST_SAMPLES && here >= PRESENT * size)
            return size;
    }
    return 0;
}

/* Choose the number of blocks of a window, 0 for none, -1 without memory, and of cells in a block.
   A block is doubled until few are lacking, since frames may come in bunches. */
static long long
choose_size(const Samples *s, long long count, long long whole, long long ahead, int exact,
            long long *block)
{
    long long there = 0, oldest = 0, size = 0, tried = (whole + MOST_SAMPLES - 1) / MOST_SAMPLES;
    for (long long k = 0; k < count; k++)
        if (s->weight[0][k] > 0 && s->weight[1][k] > 0)
            there++, oldest = k + 1;
    *block = tried;
    if (there < FEWEST_SAMPLES || ahead < 0 || ahead >= oldest)
        return 0;
    long long *seen = buffer(OF_WINDOW, count * sizeof(long long));
    if (!seen)
        return -1;
    for (; whole / tried >= FEWEST_SAMPLES; tried *= 2) {
        long long blocks = (count + tried - 1) / tried, sum = 0;
        for (long long b = 0; b < blocks; b++) {
            int any = 0;
            for (long long k = b * tried; k < (b + 1) * tried && k < count; k++)
                any |= s->weight[0][k] > 0 && s->weight[1][k] > 0;
            seen[b] = sum += any;
        }
        long long found = find_size(whole / tried, oldest / tried, ahead / tried, exact, seen,
                                    blocks);
        if (!found)
            continue;
        size = found, *block = tried;
        if (size - seen[(size < blocks ? size : blocks) - 1] <= MOST_LACKING)
            break;
    }
    return size;
}

/* Average the samples in each block, the oldest first; the noise of a mean is `coarser` times that
   of a sample. */
static void
average(const Samples *cells, long long block, Samples *out, double *coarser)
{
    for (long long b = 0; b < out->count; b++) {
        long long first = b * block, at = out->count - 1 - b, number = 0;
        double best[2] = {0.0}, variance[2] = {0.0}, late = 0.0;
        for (int c = 0; c < 2; c++)
            for (long long k = first; k < first + block; k++)
                best[c] = larger(best[c], cells->weight[c][k]);
        for (long long k = first; k < first + block; k++) {
            double a = cells->weight[0][k], p = cells->weight[1][k];
            /* Poor samples are left out: all in a mean have the same share. */
            if (!(a >= POOR * best[0] && p >= POOR * best[1] && a > 0 && p > 0))
                continue;
            number++, variance[0] += 1 / a, variance[1] += 1 / p;
            for (int c = 0; c < 3; c++)
                out->x[c][at] += cells->x[c][k];
            /* The mean time of a block moves with its missing samples. */
            late += cells->off[k] + (block - 1) / 2.0 - (k - first);
        }
        if (!number)
            continue;
        for (int c = 0; c < 3; c++)
            out->x[c][at] /= number;
        for (int c = 0; c < 2; c++)
            out->weight[c][at] = number * number / variance[c] / block;
        late /= number * block;
        out->off[at] = fabs(late) < OFF ? 0.0 : late;
    }
    for (int c = 0; c < (block > 1 ? 2 : 0); c++) {
        double usual = usual_of(out->weight[c], out->count);
        coarser[c] = 1 / sqrt(block * usual);
        make_weights(out->weight[c], out->count, usual);
    }
    divide(out, coarser);
}

/* Put missing samples on parabolas through the nearest of the others, the older of two as near. */
static void
fill_missing(const Samples *s)
{
    for (long long t = 0; t < s->count; t++) {
        if (s->weight[1][t] > 0)
            continue;
        /* Moments of the places, and of the samples by these. */
        double m[5] = {0.0}, sums[3][3] = {{0.0}};
        int found = 0;
        for (long long step = 1; found < NEAREST && step < s->count; step++)
            for (int side = -1; side <= 1 && found < NEAREST; side += 2) {
                long long k = t + side * step;
                if (k < 0 || k >= s->count || !(s->weight[1][k] > 0))
                    continue;
                double place = (side * step + s->off[k]) / NEAREST, power = 1.0;
                for (int n = 0; n < 5; n++, power *= place) {
                    m[n] += power;
                    for (int c = 0; c < 3 && n < 3; c++)
                        sums[c][n] += power * s->x[c][k];
                }
                found++;
            }
        /* The value of the parabola at the cell, by Cramer's rule. */
        double a = m[2] * m[4] - m[3] * m[3], b = m[2] * m[3] - m[1] * m[4];
        double d = m[1] * m[3] - m[2] * m[2], det = m[0] * a + m[1] * b + m[2] * d;
        for (int c = 0; c < 3; c++)
            s->x[c][t] = (a * sums[c][0] + b * sums[c][1] + d * sums[c][2]) / det;
    }
}

/* Move samples to the even grid by parabolas through their neighbors. */
static void
move_by_neighbors(const Samples *s, double *const moved[3])
{
    long long n = s->count;
    for (int c = 0; c < 3; c++)
        for (long long k = 0; k < n; k++) {
            const double *y = s->x[c];
            long long low = k > 0 ? k - 1 : 0, high = k < n - 1 ? k + 1 : n - 1;
            double before = k + s->off[k] - low - s->off[low];
            double after = high + s->off[high] - k - s->off[k];
            double first = (y[k] - y[low]) / before, second = (y[high] - y[k]) / after;
            double at = s->off[k];
            double bend = (second - first) / (before + after);
            if (k == 0 || k == n - 1)
                moved[c][k] = y[k] - at * (k ? first : second);
            else
                moved[c][k] = y[k] - (at * (first + bend * before) - at * at * bend);
        }
}
