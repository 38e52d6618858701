/*
 * Poses fitted to the markers of a frame.
 */

#ifndef KINPOLE_FIT_H
#define KINPOLE_FIT_H

#include "../include/frames.h"

/* Fits the poses of all bodies to `markers` (B, n), and writes the newest row; what is unusual. */
int kinpole_fit_frame(const Frames *f, const Number *markers, int goes_on);
/* Counts the whole turns of the newest row. */
void kinpole_unwrap(const Frames *f);

#endif
