/* SPDX-License-Identifier: Apache-2.0 */
/* What reading the wire format takes: its numbers, which abi.h has from hueflight_protocol, and
 * loads of any alignment. */
#ifndef HUEFLIGHT_WIRE_H
#define HUEFLIGHT_WIRE_H
#include <stdint.h>
#include "abi.h"
#include <stdlib.h>
#include <string.h>

#if defined(__x86_64__)
#define X86_DISPATCH 1 /* variants for newer processors, selected at run time */
#include <immintrin.h>
#if defined(__clang__) /* clang has no such option */
#define WIDEST_VECTORS
#else
#define WIDEST_VECTORS ",prefer-vector-width=512"
#endif
#define AVX512 __attribute__((target( \
    "avx512f,avx512bw,avx512vl,avx512vbmi,avx512vbmi2,vpclmulqdq,bmi,bmi2,popcnt,sse4.2" \
    WIDEST_VECTORS)))
#define AVX512_INLINE AVX512 static inline __attribute__((always_inline))
#endif

#if !defined(__GNUC__) /* clang defines it too */
#error "the kernels need gcc or clang; without them the NumPy reference implementation is used"
#endif
#define INLINE static inline __attribute__((always_inline))
#define PREFETCH_NOW(p) __builtin_prefetch(p)       /* into the level-1 cache, for immediate use */
#define PREFETCH(p) __builtin_prefetch(p, 0, 2) /* into level 2, for later use */
#define PREFETCH_ROW(p) __builtin_prefetch(p, 1, 2) /* into level 2, for writing */
#define ONE_BY_ONE() __asm__("" : : : "memory") /* keep the compiler from merging adjacent stores */
#define LOWEST_BIT(m) ((unsigned)__builtin_ctzll(m))
#define POPCOUNT(m) ((unsigned)__builtin_popcountll(m))

static const uint32_t STREAMED = 0xffffffffu;

INLINE uint16_t load16(const uint8_t *p) { return (uint16_t)(p[0] | p[1] << 8); }
INLINE uint32_t load32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}
INLINE uint64_t load64(const uint8_t *p) { return load32(p) | (uint64_t)load32(p + 4) << 32; }

/* Instruction sets of this processor; set by start_kernels. */
static int has_crc_instruction, has_bit_instructions, has_avx2, has_avx512;

#endif
