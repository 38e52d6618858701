#include <math.h>
#include <stdlib.h>

#include "window.h"
#include "memory.h"
#include "numbers.h"

/* A gap that is off a whole number of intervals by more than this makes their count doubtful. */
#define DOUBTFUL_GAP 0.2
/* If the count is doubtful, up to so many intervals more and fewer are tried. */
#define MAX_MISCOUNT 4
/* Cells of a window, most of which are empty where frames come in bunches: a bound of memory. */
#define MAX_CELLS 4096
/* More samples than this in a window are averaged in blocks: cost goes by their number squared. */
#define MAX_SAMPLES 128
/* Samples of a block with less than this share of the information of the best are left out. */
#define POOR_INFORMATION 0.25
/* Samples differ by no more deviations of their noise, or the noise is taken for larger. */
#define MAX_EXACT_RATIO 1e13
/* Part of the samples of a window that must be present. */
#define MIN_FILLED 0.5
/* A window is at most so many times as long as the samples that are present reach. */
#define MAX_SIZE_RATIO 1.25

/* Compare the doubles `a` and `b`, for qsort. */
static int
compare_numbers(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Return the interval, ns, by which frames at the times `time` (frames), ns, are nearest to even
   places, with about so many `intervals` in their `span`, ns: the number with the largest sum of
   exp(2 pi i t / interval), then a regression. */
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

PRIVATE int
find_grid(Call *call, long long instant, Grid *grid)
{
    const long long *windows = call->windows + instant;
    long long now = windows[0], newest = windows[2 * call->instants];
    long long frames = newest - windows[call->instants] + 1;
    double *time = kinpole_buffer(call, OF_GRID, frames * 4 * sizeof(double));
    if (!time)
        return NO_MEMORY;
    double *steps = time + frames;
    grid->off = steps + frames, grid->cell = (long long *)(grid->off + frames);
    for (long long k = 0; k < frames; k++)
        time[k] = call->time[newest - k] - call->time[now];
    double span = time[0] - time[frames - 1];
    grid->interval = span / (frames - 1);
    int even = 1;
    for (long long k = 0; k < frames; k++) {
        grid->cell[k] = newest - now - k, grid->off[k] = 0.0;
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
        double off = place - grid->cell[k];
        grid->off[k] = fabs(off) < MAX_OFF_GRID ? 0.0 : off;
    }
    return DONE;
}

PRIVATE int
fill_cells(Call *call, long long instant, long long body, const Grid *grid, Cells *cells)
{
    const long long *windows = call->windows + instant, bodies = call->bodies;
    long long now = windows[0] * bodies + body, newest = windows[2 * call->instants];
    long long frames = newest - windows[call->instants] + 1, signal = instant * bodies + body;
    long long oldest = 0, count = 0, ahead = -1;
    Samples *s = &cells->samples;
    *cells = (Cells){.exact = 0};
    /* The first pass finds the range of the cells. */
    for (int pass = 0; pass < 2; pass++) {
        double a = call->angle[now], turns = call->turns[now];
        double x = creal(call->position[now]), y = cimag(call->position[now]);
        /* Without a pose at the instant, samples are relative to zero. */
        if (isnan(a))
            a = turns = x = y = 0.0;
        for (long long k = call->left_out[signal]; k < frames; k++) {
            long long row = (newest - k) * bodies + body, cell = grid->cell[k], at = ahead - cell;
            if (!(call->angle_information[row] > 0 && call->position_information[row] > 0))
                continue;
            if (pass) {
                s->x[0][at] = call->angle[row] - a + 2 * M_PI * (call->turns[row] - turns);
                s->x[1][at] = creal(call->position[row]) - x;
                s->x[2][at] = cimag(call->position[row]) - y;
                s->weight[0][at] = call->angle_information[row];
                s->weight[1][at] = call->position_information[row];
                s->off[at] = grid->off[k];
            } else {
                oldest = count == 0 || cell < oldest ? cell : oldest;
                ahead = count == 0 || cell > ahead ? cell : ahead;
                count = ahead - oldest + 1;
            }
        }
        if (count < FEWEST_SAMPLES)
            return DONE;
        if (!pass && !lay_out_samples(call, OF_CELLS, (long long)(MAX_SIZE_RATIO * count) + 1, s))
            return NO_MEMORY;
    }
    cells->count = count, cells->ahead = ahead;
    for (int c = 0; c < 2; c++) {
        double most = largest_sample(s, c), usual = mean_of_similar(s->weight[c], count);
        /* The noise is no less than rounding. */
        cells->unit[c] = larger(call->noise[signal] / sqrt(usual), most / MAX_EXACT_RATIO);
        cells->exact |= most > EXACT_RATIO * cells->unit[c];
        normalize_weights(s->weight[c], count, usual);
    }
    divide_samples(s, cells->unit);
    return DONE;
}

/* Return the number of blocks of the longest window with enough samples, or 0. A full window has
   `full` blocks, `last` is the number of whole blocks up to the oldest sample, and `ahead` blocks
   are newer than the instant. filled[k], k < `blocks`, is how many of the first k + 1 blocks, from
   the newest, have samples. A window of `exact` samples is as long as these reach, of any size. */
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

PRIVATE long long
choose_size(Call *call, const Cells *cells, long long whole, long long *block)
{
    const Samples *s = &cells->samples;
    long long count = cells->count, ahead = cells->ahead, present = 0, oldest = 0, size = 0;
    long long tried = (whole + MAX_SAMPLES - 1) / MAX_SAMPLES;
    for (long long k = 0; k < count; k++)
        if (s->weight[0][k] > 0 && s->weight[1][k] > 0)
            present++, oldest = k + 1;
    *block = tried;
    if (present < FEWEST_SAMPLES || ahead < 0 || ahead >= oldest)
        return 0;
    long long *filled = kinpole_buffer(call, OF_WINDOW, count * sizeof(long long));
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
        long long number = find_size(whole / tried, oldest / tried, ahead / tried, cells->exact,
                                     filled, blocks);
        if (!number)
            continue;
        size = number, *block = tried;
        if (size - filled[(size < blocks ? size : blocks) - 1] <= MAX_LOW_WEIGHT)
            break;
    }
    return size;
}

PRIVATE void
average_blocks(const Samples *cells, long long block, Samples *out, double *coarser)
{
    for (long long b = 0; b < out->count; b++) {
        long long first = b * block, at = out->count - 1 - b, number = 0;
        double best[2] = {0.0}, variance[2] = {0.0}, off = 0.0;
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
            off += cells->off[k] + (block - 1) / 2.0 - (k - first);
        }
        if (!number)
            continue;
        for (int c = 0; c < 3; c++)
            out->x[c][at] /= number;
        for (int c = 0; c < 2; c++)
            out->weight[c][at] = number * number / variance[c] / block;
        off /= number * block;
        out->off[at] = fabs(off) < MAX_OFF_GRID ? 0.0 : off;
    }
    for (int c = 0; c < (block > 1 ? 2 : 0); c++) {
        double usual = mean_of_similar(out->weight[c], out->count);
        coarser[c] = 1 / sqrt(block * usual);
        normalize_weights(out->weight[c], out->count, usual);
    }
    divide_samples(out, coarser);
}
