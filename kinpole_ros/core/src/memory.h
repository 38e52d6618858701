/*
 * Memory that the library works in, which belongs to a `Call` and is used again by its next call.
 */

#ifndef KINPOLE_MEMORY_H
#define KINPOLE_MEMORY_H

#include <stddef.h>

#include "../include/call.h"

enum {
    OF_POSES,
    OF_DERIVATIVES,
    OF_HEADINGS,
    OF_GRID,
    OF_CELLS,
    OF_WINDOW,
    OF_MODELS,
    OF_SETS,
    OF_SEGMENTS,
    OF_HUB,
    BUFFERS
};

/* Let an array begin at `data`, and move `data` behind it. */
#define TAKE(array, size) (array = (void *)data, data += (size) * sizeof *array)

/* Return memory for one purpose, as the last call left it, or zeros; NULL if there is none. */
void *kinpole_buffer(Call *call, int which, size_t size);
/* Let the derivatives of so many poses, bodies at instants, point into memory for one purpose.
   Returns DONE or NO_MEMORY. */
int kinpole_lay_out_derivatives(Call *call, int which, long long poses, DerivativeArrays *d);

#endif
