/*
 * Memory that the library works in, which belongs to a `Call` and is used again by its next call.
 */

#ifndef KINPOLE_MEMORY_H
#define KINPOLE_MEMORY_H

#include <stddef.h>

#include "../include/call.h"

/* What memory is for: each is one array, which the next call for the same purpose uses again. */
enum {
    OF_POSES, OF_DERIVATIVES, OF_HEADINGS, OF_GRID, OF_CELLS,
    OF_WINDOW, OF_MODELS, OF_SETS, OF_SEGMENTS, OF_HUB, BUFFERS,
};

/* Let an array of `size` elements begin at `data`, and move `data` behind it. */
#define TAKE(array, size) (array = (void *)data, data += (size) * sizeof *array)

/* Return `size` bytes of memory for the purpose `which`: as the last call left them, or zeros if it
   had less; NULL if there is no memory. */
void *kinpole_buffer(Call *call, int which, size_t size);
/* Let the arrays of `d` point into memory for the purpose `which`, for so many `poses`, bodies at
   instants, and the orders of `call`. Returns DONE or NO_MEMORY. */
int kinpole_lay_out_derivatives(Call *call, int which, long long poses, DerivativeArrays *d);

#endif
