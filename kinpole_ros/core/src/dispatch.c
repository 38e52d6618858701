/*
 * The estimator with the widest vectors that the processor has.
 */

#include "estimator.h"

int
kinpole_derive(Call *call)
{
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        return derive_signals_avx2(call);
#endif
    return derive_signals(call);
}
