/*
 * From poses at stamps to even samples.
 *
 * `find_grid` finds the usual interval between the frames of a window, and the cell of each frame.
 * `fill_cells` fills the cells of one body. `choose_size` chooses the number of samples, because
 * each number needs models of its own, and `average_blocks` averages cells in blocks if there are
 * too many. A sample may be missing, have a low weight, or be off its place, by the intervals in
 * `off`. `fill_missing` and `move_by_neighbors` give the first guesses of even samples.
 */

/* Samples of the shortest window, which still has every order; as in _models.py. */
#define FEWEST_SAMPLES 7
/* More samples than this in a window are averaged in blocks: cost goes by their number squared. */
#define MAX_SAMPLES 128
/* Samples with this share of the largest information get a weight of 1: a lower one costs time. */
#define SIMILAR_INFORMATION 0.5
/* Samples of a block with less than this share of the information of the best are left out. */
#define POOR_INFORMATION 0.25
/* A sample is on the grid if it is off by less than this part of the interval. */
#define MAX_OFF_GRID 1e-4
/* A gap that is off a whole number of intervals by more than this makes their count doubtful. */
#define DOUBTFUL_GAP 0.2
/* If the count is doubtful, up to so many intervals more and fewer are tried. */
#define MAX_MISCOUNT 4
/* Cells of a window, most of which are empty where frames come in bunches: a bound of memory. */
#define MAX_CELLS 4096
/* Samples that differ by more deviations of their noise are exact: about the largest amplitude. */
#define EXACT_RATIO 1e7
/* Samples differ by no more deviations of their noise, or the noise is taken for larger. */
#define MAX_EXACT_RATIO 1e13
/* Part of the samples of a window that must be present. */
#define MIN_FILLED 0.5
/* A window is at most so many times as long as the samples that are present reach. */
#define MAX_SIZE_RATIO 1.25
/* Low weights of a window above which its blocks are doubled: cost goes by their number squared. */
#define MAX_LOW_WEIGHT 24
/* A missing sample is first put on a parabola through so many others. */
#define PARABOLA_SAMPLES 6
/* Rounds in which samples move, besides the first and the last two. */
#define MAX_ROUNDS 6
/* The same for exact samples, whose noise does not hide what is left of the movement. */
#define MAX_EXACT_ROUNDS 38
/* Samples that move by less than so many deviations of their noise are settled. */
#define SETTLED_SIGMAS 0.05
/* Noise prior, in samples, while samples move: their noise is larger than the measured one. */
#define MOVING_PRIOR_SAMPLES 1.0

#include "_call.h"

/* The even cells of an instant. Arrays are by frame, the newest first. */
typedef struct {
    double interval; /* ns */
    double *late;    /* intervals after the cell */
    long long *cell; /* intervals after the instant */
} Grid;

/* Memory of a thread that is used again by the next call. */
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
compare_numbers(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Return the interval, ns, by which frames are nearest to even places, with about so many in the
   span: the number with the largest sum of exp(2 pi i t / interval), then a regression. */
static double
clearest_interval(const double *time, long long frames, double span, double intervals)
{
    double best = -1.0, number = 1.0, x = 0.0, y = 0.0;
    for (int more = -MAX_MISCOUNT; more <= MAX_MISCOUNT; more++) {
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

/* Find the grid of the instant of frame `now`, for a window of so many frames up to `newest`. */
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
        even &= fabs(time[k] - grid->cell[k] * grid->interval) <= MAX_OFF_GRID * grid->interval;
    }
    if (even)
        return DONE;
    for (long long k = 0; k < frames - 1; k++)
        steps[k] = time[k] - time[k + 1];
    qsort(steps, frames - 1, sizeof(double), compare_numbers);
    /* The median interval, but no less than MAX_CELLS allow, because frames may come in bunches. */
    double usual = larger(steps[(frames - 2) / 2], span / MAX_CELLS), intervals = 0.0;
    int doubtful = 0;
    for (long long k = 0; k < frames - 1; k++) {
        double number = rint(steps[k] / usual);
        intervals += number;
        doubtful |= fabs(steps[k] / usual - number) > DOUBTFUL_GAP;
    }
    intervals = larger(intervals, 1.0);
    grid->interval = doubtful ? clearest_interval(time, frames, span, intervals) : span / intervals;
    /* Cells are rounded about the mean phase of the frames, where fewest frames share a cell. */
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
        grid->late[k] = fabs(late) < MAX_OFF_GRID ? 0.0 : late;
    }
    return DONE;
}

/* Return the mean of the numbers that are at least SIMILAR_INFORMATION times the largest. */
static double
mean_of_similar(const double *information, long long count)
{
    double best = 0.0, sum = 0.0, number = 0.0;
    for (long long k = 0; k < count; k++)
        best = larger(best, information[k]);
    for (long long k = 0; k < count; k++)
        if (information[k] >= SIMILAR_INFORMATION * best)
            sum += information[k], number += 1.0;
    return sum / number;
}

/* Divide information by the usual one, in place; weights of similar information are 1. */
static void
normalize_weights(double *weight, long long count, double usual)
{
    for (long long k = 0; k < count; k++) {
        weight[k] = usual > 0 ? weight[k] / usual : 0.0;
        weight[k] = weight[k] >= SIMILAR_INFORMATION ? 1.0 : weight[k];
    }
}

/* Lay out samples of zeros; returns 0 if there is no memory. */
static int
lay_out_samples(Samples *s, int which, long long count)
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

/* Divide the samples of angle and position by a number each, as their noise. */
static void
divide_samples(const Samples *s, const double *by)
{
    for (int c = 0; c < 3; c++)
        for (long long k = 0; k < s->count; k++)
            s->x[c][k] /= by[c > 0];
}

/* Return the largest size of a sample of the angle, or of a coordinate. */
static double
largest_sample(const Samples *s, int c)
{
    double most = 0.0;
    for (int d = c; d <= 2 * c; d++)
        for (long long k = 0; k < s->count; k++)
            most = larger(most, fabs(s->x[d][k]));
    return most;
}

/* Fill the cells of one body, the newest first, relative to its pose at the instant and in units of
   the noise, `unit` (2), rad and m. `count` is the number of cells, 0 if they are too few, and
   `ahead` how many are newer than the instant; empty cells follow, for a window that is not full.
   `exact` is set if the motion is larger than EXACT_RATIO times the noise. */
static int
fill_cells(const Call *call, long long instant, long long body, const Grid *grid, Samples *s,
           long long *count, long long *ahead, double *unit, int *exact)
{
    const long long *windows = call->windows + instant, bodies = call->bodies;
    long long now = windows[0] * bodies + body, newest = windows[2 * call->instants];
    long long frames = newest - windows[call->instants] + 1, signal = instant * bodies + body;
    long long oldest = 0;
    *ahead = -1, *count = 0;
    /* The first pass finds the range of the cells. */
    for (int pass = 0; pass < 2; pass++) {
        double a = call->angle[now], turns = call->turns[now];
        double x = call->position[2 * now], y = call->position[2 * now + 1];
        /* Without a pose at the instant, samples are relative to zero. */
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
        else if (!pass && !lay_out_samples(s, OF_CELLS, (long long)(MAX_SIZE_RATIO * *count) + 1))
            return NO_MEMORY;
        if (!*count)
            return DONE;
    }
    for (int c = 0; c < 2; c++) {
        double most = largest_sample(s, c), usual = mean_of_similar(s->weight[c], *count);
        /* The noise is no less than rounding. */
        unit[c] = larger(call->noise[signal] / sqrt(usual), most / MAX_EXACT_RATIO);
        *exact |= most > EXACT_RATIO * unit[c];
        normalize_weights(s->weight[c], *count, usual);
    }
    divide_samples(s, unit);
    return DONE;
}

/* Return the number of blocks of the longest window with enough samples, or 0. A full window has
   `full` blocks, `last` is the number of whole blocks up to the oldest sample, and `ahead` blocks
   are newer than the instant. `filled[k]` is how many of the first k + 1 blocks have samples. */
static long long
find_size(long long full, long long last, long long ahead, int exact, const long long *filled,
          long long blocks)
{
    /* Windows that are not full have few sizes, because models of a size take time to make. */
    long long sizes[32] = {FEWEST_SAMPLES}, number = 1, present = full < last ? full : last;
    while ((long long)(sizes[number - 1] * MAX_SIZE_RATIO) <= MAX_SAMPLES)
        sizes[number] = (long long)(sizes[number - 1] * MAX_SIZE_RATIO), number++;
    /* With uneven stamps a window has one frame more or less. */
    long long most = last == full - 1 ? last : full;
    for (long long k = number; k >= -1; most = k > 0 ? sizes[k - 1] : full, k--) {
        /* The last attempt is the samples alone, for an instant that is the oldest of them. */
        long long size = exact || k < 0 ? present : most < full ? most : full;
        if (k >= 0 && size > MAX_SIZE_RATIO * last)
            continue;
        if (size < FEWEST_SAMPLES || size <= ahead)
            continue;
        double number_filled = filled[(size < blocks ? size : blocks) - 1];
        if (number_filled >= FEWEST_SAMPLES && number_filled >= MIN_FILLED * size)
            return size;
    }
    return 0;
}

/* Return the number of blocks of a window, 0 for none, -1 without memory; `block` is the number of
   cells in each. A full window has `whole` cells. Blocks are doubled until few are empty, because
   frames may come in bunches. */
static long long
choose_size(const Samples *s, long long count, long long whole, long long ahead, int exact,
            long long *block)
{
    long long present = 0, oldest = 0, size = 0, tried = (whole + MAX_SAMPLES - 1) / MAX_SAMPLES;
    for (long long k = 0; k < count; k++)
        if (s->weight[0][k] > 0 && s->weight[1][k] > 0)
            present++, oldest = k + 1;
    *block = tried;
    if (present < FEWEST_SAMPLES || ahead < 0 || ahead >= oldest)
        return 0;
    long long *filled = buffer(OF_WINDOW, count * sizeof(long long));
    if (!filled)
        return -1;
    for (; whole / tried >= FEWEST_SAMPLES; tried *= 2) {
        long long blocks = (count + tried - 1) / tried, sum = 0;
        for (long long b = 0; b < blocks; b++) {
            int is_filled = 0;
            for (long long k = b * tried; k < (b + 1) * tried && k < count; k++)
                is_filled |= s->weight[0][k] > 0 && s->weight[1][k] > 0;
            filled[b] = sum += is_filled;
        }
        long long number = find_size(whole / tried, oldest / tried, ahead / tried, exact, filled,
                                     blocks);
        if (!number)
            continue;
        size = number, *block = tried;
        if (size - filled[(size < blocks ? size : blocks) - 1] <= MAX_LOW_WEIGHT)
            break;
    }
    return size;
}

/* Average the cells in each block, into samples in units of their noise, the oldest first. Their
   noise is `coarser` (2) times that of a cell. */
static void
average_blocks(const Samples *cells, long long block, Samples *out, double *coarser)
{
    for (long long b = 0; b < out->count; b++) {
        long long first = b * block, at = out->count - 1 - b, number = 0;
        double best[2] = {0.0}, variance[2] = {0.0}, late = 0.0;
        for (int c = 0; c < 2; c++)
            for (long long k = first; k < first + block; k++)
                best[c] = larger(best[c], cells->weight[c][k]);
        for (long long k = first; k < first + block; k++) {
            double a = cells->weight[0][k], p = cells->weight[1][k];
            /* All samples of a mean count equally, so poor ones are left out. */
            int is_poor = !(a >= POOR_INFORMATION * best[0] && p >= POOR_INFORMATION * best[1]);
            if (is_poor || !(a > 0 && p > 0))
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
        out->off[at] = fabs(late) < MAX_OFF_GRID ? 0.0 : late;
    }
    for (int c = 0; c < (block > 1 ? 2 : 0); c++) {
        double usual = mean_of_similar(out->weight[c], out->count);
        coarser[c] = 1 / sqrt(block * usual);
        normalize_weights(out->weight[c], out->count, usual);
    }
    divide_samples(out, coarser);
}

/* Put missing samples on parabolas through the nearest of the others; of two equally near ones, the
   older is the first. */
static void
fill_missing(const Samples *s)
{
    for (long long t = 0; t < s->count; t++) {
        if (s->weight[1][t] > 0)
            continue;
        /* Sums of powers of the places, and of the samples times these. */
        double m[5] = {0.0}, sums[3][3] = {{0.0}};
        int number = 0;
        for (long long step = 1; number < PARABOLA_SAMPLES && step < s->count; step++)
            for (int side = -1; side <= 1 && number < PARABOLA_SAMPLES; side += 2) {
                long long k = t + side * step;
                if (k < 0 || k >= s->count || !(s->weight[1][k] > 0))
                    continue;
                double place = (side * step + s->off[k]) / PARABOLA_SAMPLES, power = 1.0;
                for (int n = 0; n < 5; n++, power *= place) {
                    m[n] += power;
                    for (int c = 0; c < 3 && n < 3; c++)
                        sums[c][n] += power * s->x[c][k];
                }
                number++;
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
