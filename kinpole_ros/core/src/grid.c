#include <math.h>
#include <stdlib.h>

#include "grid.h"
#include "../include/call.h"
#include "memory.h"
#include "numbers.h"

/* A gap that is off a whole number of intervals by more than this makes their count doubtful. */
#define DOUBTFUL_GAP 0.2
/* If the count is doubtful, up to so many intervals more and fewer are tried. */
#define MAX_MISCOUNT 4
/* Cells of a window, most of which are empty where frames come in bunches: a bound of memory. */
#define MAX_CELLS 4096

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
    grid->late = steps + frames, grid->cell = (long long *)(grid->late + frames);
    for (long long k = 0; k < frames; k++)
        time[k] = call->time[newest - k] - call->time[now];
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
