/* estimator.c for processors with AVX2: vectors are broken up badly unless these are asked for. */

#if defined(__x86_64__)
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
#pragma GCC target("avx2,fma")
#endif
#define WIDTH 4
#define DERIVE_SIGNALS derive_signals_avx2
#include "estimator.c"
#ifdef __clang__
#pragma clang attribute pop
#endif
#endif
