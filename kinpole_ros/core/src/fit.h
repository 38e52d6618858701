/*
 * Poses fitted to the markers of a frame.
 */

#ifndef KINPOLE_FIT_H
#define KINPOLE_FIT_H

#include "../include/frames.h"

/* Fits the poses of all bodies to `markers` (B, n), m. Writes `used`, `residual`, `angle`,
   `position` and `information` of the newest row, and `unusual`. `goes_on` is whether the row
   before is of the frame before. Returns the UNUSUAL_BITS of all bodies. */
int kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on);
/* Counts the whole turns from the last known angle of each body to that of the newest row. Writes
   `turns` of that row, and `last_angle`. */
void kinpole_unwrap(const Frames *f);

#endif
