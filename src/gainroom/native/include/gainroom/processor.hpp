// What compilers are told of processors.
#pragma once

// Loops over entries, as many at a time as the processor has room for. Products and sums stay apart: all processors have the same digits.
// What such a loop calls has to be inlined: a call would leave these wide registers for every number.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define GAINROOM_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define GAINROOM_WIDE
#endif

// Product and sum in one instruction, for processors that have it, where digits need not be those of all processors.
#if defined(__GNUC__) && defined(__x86_64__) && !defined(GAINROOM_PLAIN)
#include <immintrin.h>
#define GAINROOM_FUSED __attribute__((target("avx2,fma")))
#endif

// Inlined always: compilers stop inlining where a file is long, and a call would not know in which registers the caller's processor returns
// four numbers.
#if defined(__GNUC__)
#define GAINROOM_INLINE inline __attribute__((always_inline))
#else
#define GAINROOM_INLINE inline
#endif
