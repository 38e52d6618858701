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
/* Samples that differ by more deviations of their noise are exact: about the largest amplitude of a
   model. */
#define EXACT_RATIO 1e7
/* Low weights of a window above which its blocks are doubled: cost goes by their number squared. */
#define MAX_LOW_WEIGHT 24

/* The even cells of an instant. Arrays are by frame of its window, the newest first. */
typedef struct {
    double interval; /* ns: from one cell to the next */
    double *off;     /* intervals by which the frame is after its cell */
    long long *cell; /* intervals by which its cell is after the instant, below 0 if before */
} Grid;

/* Find the grid of an instant, from the frames of its window, at least 2. Its arrays are memory
   that the next call uses again. Returns DONE or NO_MEMORY. */
PRIVATE int find_grid(Call *call, long long instant, Grid *grid);

/* The cells of one body, from the newest to the oldest that has a pose. */
typedef struct {
    Samples samples; /* the newest first; empty cells follow, for a window that is not full */
    long long count; /* cells, without those that follow; 0 if they are fewer than FEWEST_SAMPLES */
    long long ahead; /* cells newer than the instant; below 0 if all are older */
    double unit[2];  /* rad, m: the noise of a sample of weight 1 */
    int exact;       /* whether the motion is larger than EXACT_RATIO times the noise */
} Cells;

/* Fill the cells of one body on a `grid` of `find_grid`, relative to its pose at the instant: of
   several frames in a cell the oldest counts. A cell without a frame that is used is a missing
   sample. Returns DONE or NO_MEMORY. */
PRIVATE int fill_cells(Call *call, long long instant, long long body, const Grid *grid,
                       Cells *cells);

/* Return the number of blocks of a window, which become its samples; 0 if too few cells are filled
   or the instant is not among them; -1 without memory. Writes the number of cells in each `block`.
   A full window has `whole` cells. Blocks are doubled until few are empty, because frames may come
   in bunches. */
PRIVATE long long choose_size(Call *call, const Cells *cells, long long whole, long long *block);

/* Average the `cells` in each block, into samples `out`, which are zeros, in units of their noise,
   the oldest first. Empty cells follow those of a window that is not full, up to the last block.
   Writes to `coarser` (2) their noise over that of a cell; it stays if a block is one cell. */
PRIVATE void average_blocks(const Samples *cells, long long block, Samples *out, double *coarser);

#endif
