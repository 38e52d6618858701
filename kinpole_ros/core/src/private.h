/*
 * Functions that the files of the estimator share.
 *
 * estimator.c includes these files, and estimator_avx2.c includes them again, so the functions of
 * either are its own. A file that is compiled by itself, as in tests, shares them with the others.
 */

#ifndef KINPOLE_PRIVATE_H
#define KINPOLE_PRIVATE_H

#ifdef KINPOLE_ESTIMATOR
#define PRIVATE static
#define PRIVATE_INLINE static inline
#else
#define PRIVATE
#define PRIVATE_INLINE
#endif

#endif
