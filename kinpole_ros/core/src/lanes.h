/*
 * The amplitudes of a process, side by side in vectors of the processor.
 */

#ifndef KINPOLE_LANES_H
#define KINPOLE_LANES_H

#include "../include/codes.h"

/* Doubles in a vector: estimator_avx2.c has 4. */
#ifndef WIDTH
#define WIDTH 2
#endif
#define VECTORS (LANES / WIDTH)

/* As wide as the vectors of the processor: compilers break up wider ones badly. */
typedef double Vector __attribute__((vector_size(8 * WIDTH), aligned(8)));
typedef struct {
    Vector part[VECTORS];
} Lanes;

/* For each vector h of some lanes. Functions below work on each lane by itself. */
#define FOR_VECTORS for (int h = 0; h < VECTORS; h++)

/* One value in all lanes. */
static inline Lanes
all_lanes(double value)
{
    Lanes all;
    FOR_VECTORS all.part[h] = (Vector){0} + value;
    return all;
}

/* a times the number `by` */
static inline Lanes
scaled(Lanes a, double by)
{
    FOR_VECTORS a.part[h] *= by;
    return a;
}

/* a b */
static inline Lanes
product(Lanes a, Lanes b)
{
    FOR_VECTORS a.part[h] *= b.part[h];
    return a;
}

/* sum + a b */
static inline Lanes
multiply_add(Lanes sum, Lanes a, Lanes b)
{
    FOR_VECTORS sum.part[h] += a.part[h] * b.part[h];
    return sum;
}

/* sum - a b */
static inline Lanes
multiply_subtract(Lanes sum, Lanes a, Lanes b)
{
    FOR_VECTORS sum.part[h] -= a.part[h] * b.part[h];
    return sum;
}

/* The sum over the lanes. */
static inline double
sum_of(Lanes lanes)
{
    double sum = 0.0;
    for (int i = 0; i < LANES; i++)
        sum += ((double *)&lanes)[i];
    return sum;
}

#endif
