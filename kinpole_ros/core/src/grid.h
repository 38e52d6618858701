/*
 * The usual interval between the frames of a window, and the cell of each frame.
 */

#ifndef KINPOLE_GRID_H
#define KINPOLE_GRID_H

#include "../include/call.h"
#include "private.h"

/* A sample is on the grid if it is off by less than this part of the interval. */
#define MAX_OFF_GRID 1e-4

/* The even cells of an instant. Arrays are by frame, the newest first. */
typedef struct {
    double interval; /* ns */
    double *late;    /* intervals after the cell */
    long long *cell; /* intervals after the instant */
} Grid;

/* Find the grid of an instant, from the frames of its window. */
PRIVATE int find_grid(Call *call, long long instant, Grid *grid);

#endif
