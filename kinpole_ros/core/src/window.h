/*
 * From poses at stamps to even samples.
 *
 * `find_grid` finds the usual interval between the frames of a window, and the cell of each frame.
 * `fill_cells` fills the cells of one body. `choose_size` chooses the number of samples, because
 * each number needs models of its own, and `average_blocks` averages cells in blocks if there are
 * too many. A sample may be missing, have a low weight, or be off its place, by the intervals in
 * `off`. `fill_missing` and `move_by_neighbors` give the first guesses of even samples.
 */

#ifndef KINPOLE_WINDOW_H
#define KINPOLE_WINDOW_H

#include "samples.h"

/* A sample is on the grid if it is off by less than this part of the interval. */
#define MAX_OFF_GRID 1e-4
/* Samples that differ by more deviations of their noise are exact: about the largest amplitude. */
#define EXACT_RATIO 1e7
/* Low weights of a window above which its blocks are doubled: cost goes by their number squared. */
#define MAX_LOW_WEIGHT 24

/* The even cells of an instant. Arrays are by frame, the newest first. */
typedef struct {
    double interval; /* ns */
    double *late;    /* intervals after the cell */
    long long *cell; /* intervals after the instant */
} Grid;

/* Find the grid of an instant, from the frames of its window. Returns DONE or NO_MEMORY. */
PRIVATE int find_grid(Call *call, long long instant, Grid *grid);

/* The cells of one body, the newest first, in units of the noise, `unit`, rad and m. `count` is the
   number of cells, 0 if they are too few, and `ahead` how many are newer than the instant; empty
   cells follow, for a window that is not full. They are `exact` if the motion is larger than
   EXACT_RATIO times the noise. */
typedef struct {
    Samples samples;
    long long count, ahead;
    double unit[2];
    int exact;
} Cells;

/* Fill the cells of one body, relative to its pose at the instant: of several frames in a cell the
   oldest counts. Returns DONE or NO_MEMORY. */
PRIVATE int fill_cells(Call *call, long long instant, long long body, const Grid *grid,
                       Cells *cells);

/* Return the number of blocks of a window, 0 for none, -1 without memory; `block` is the number of
   cells in each. A full window has `whole` cells. Blocks are doubled until few are empty, because
   frames may come in bunches. */
PRIVATE long long choose_size(Call *call, const Cells *cells, long long whole, long long *block);

/* Average the cells in each block, into samples in units of their noise, the oldest first. Their
   noise is `coarser` (2) times that of a cell. */
PRIVATE void average_blocks(const Samples *cells, long long block, Samples *out, double *coarser);

#endif
