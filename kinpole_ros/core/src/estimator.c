/*
 * All files of the estimator as one, which compilers inline across.
 *
 * estimator_avx2.c compiles this file again with the vectors of newer processors. Compilers fuse
 * products and sums there, so a changed function may change results by rounding.
 */

#define KINPOLE_ESTIMATOR

#include "samples.c"
#include "window.c"
#include "models.c"
#include "evidence.c"
#include "mean.c"
#include "screens.c"
#include "polynomials.c"
#include "segments.c"
#include "hub.c"
#include "events.c"
#include "derive.c"
