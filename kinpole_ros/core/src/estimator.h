/*
 * The estimator with the vectors of a processor.
 */

#ifndef KINPOLE_ESTIMATOR_H
#define KINPOLE_ESTIMATOR_H

#include "../include/call.h"

/* Derive as `kinpole_derive`, with vectors that every processor has, and with those of AVX2. */
int derive_signals(Call *call);
int derive_signals_avx2(Call *call);

#endif
