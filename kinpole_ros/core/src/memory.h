/*
 * Memory that a thread uses again in the next call.
 */

#ifndef KINPOLE_MEMORY_H
#define KINPOLE_MEMORY_H

#include <stddef.h>

#include "private.h"

enum { OF_GRID, OF_CELLS, OF_WINDOW, OF_MODELS, OF_SETS, BUFFERS };

/* Let an array begin at `data`, and move `data` behind it. */
#define TAKE(array, size) (array = (void *)data, data += (size) * sizeof *array)

/* Return memory of a thread for one purpose, as the last call left it; NULL if there is none. */
PRIVATE void *buffer(int which, size_t size);

#endif
