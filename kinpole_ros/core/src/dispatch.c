/*
 * The estimator with the widest vectors that the processor has.
 */

#include "estimator.h"

#if defined(__x86_64__)
#include <cpuid.h>

/* Whether the processor has AVX2 and FMA, and the system saves their registers. The compilers' own
   __builtin_cpu_supports says no where zig compiles. */
static int
has_avx2(void)
{
    enum { XMM_AND_YMM = 6 };
    unsigned a, b, c, d, saved, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE) || !(c & bit_FMA))
        return 0;
    __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    if ((saved & XMM_AND_YMM) != XMM_AND_YMM || !__get_cpuid_count(7, 0, &a, &b, &c, &d))
        return 0;
    return (b & bit_AVX2) != 0;
}
#endif

int
kinpole_derive(Call *call)
{
#if defined(__x86_64__)
    /* Asked once, since virtual machines answer slowly. */
    static int found = -1;
    if (found < 0)
        found = has_avx2();
    if (found)
        return derive_signals_avx2(call);
#endif
    return derive_signals(call);
}
