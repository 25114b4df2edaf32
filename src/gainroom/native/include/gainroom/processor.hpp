// Attributes by which functions are compiled for several processors, and the choice among them.
#pragma once

// Loops over entries, as many at a time as the processor has room for. Products and sums stay apart: all processors have the same digits.
// What such a loop calls has to be inlined: a call would leave these wide registers for every number. A choice that is made as a program is loaded
// comes too early for the thread sanitizer.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__) && !defined(__SANITIZE_THREAD__)
#define GAINROOM_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define GAINROOM_WIDE
#endif

// Product and sum in one instruction, where digits need not be those of all processors, and whether this one has that. The processor itself is
// asked: with some compilers' runtimes __builtin_cpu_supports knows of nothing.
#if defined(__GNUC__) && defined(__x86_64__) && !defined(GAINROOM_PLAIN) && !defined(GAINROOM_APART)
#include <cpuid.h>
#include <immintrin.h>
#define GAINROOM_FUSED __attribute__((target("avx2,fma")))
namespace gainroom {

inline bool processor_fuses() {
    unsigned a = 0, b = 0, c = 0, d = 0, kept = 0, high = 0;
    constexpr unsigned kFused = 1u << 12, kKeeps = 1u << 27, kWide = 1u << 5, kWideKept = 6;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & kFused) || !(c & kKeeps)) return false;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));  // what the system keeps of a process's registers
    return (kept & kWideKept) == kWideKept && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & kWide);
}

}  // namespace gainroom
#endif

// Inlined always: compilers stop inlining where a file is long, and a call would not know in which registers the caller's processor returns
// four numbers.
#if defined(__GNUC__)
#define GAINROOM_INLINE inline __attribute__((always_inline))
#else
#define GAINROOM_INLINE inline
#endif

// A short loop of fixed length, written out. Other compilers do so unasked, gcc from -O3 on only.
#if defined(__GNUC__) && !defined(__clang__)
#define GAINROOM_UNROLLED _Pragma("GCC unroll 8")
#else
#define GAINROOM_UNROLLED
#endif
