/* SPDX-License-Identifier: Apache-2.0 */
/* CRC-32C (Castagnoli), as defined in RFC 3720, appendix B.4.
 *
 * Eight bytes at a time by table. Where the processor has the crc32 instruction, three streams are
 * computed at once, because the instruction has a latency of three clocks. The three remainders are
 * combined by shifting a remainder past LANE zero bytes, a linear operation with one table per byte
 * of the remainder. */

enum { LONG_LANE = 1024, SHORT_LANE = 128, FOLDED = 256 };
static uint32_t crc_table[8][256], past_long[4][256], past_short[4][256];
static uint64_t fold_far[2], fold_near[2];

static void make_past(uint32_t table[4][256], unsigned zeros)
{
    for (unsigned byte = 0; byte < 4; byte++)
        for (unsigned value = 0; value < 256; value++) {
            uint32_t crc = (uint32_t)value << 8 * byte;
            for (unsigned i = 0; i < zeros; i++)
                crc = crc >> 8 ^ crc_table[0][crc & 255];
            table[byte][value] = crc;
        }
}

/* x^(8 n) modulo the polynomial, shifted by one as products of reflected factors require. */
static uint64_t power(unsigned n)
{
    uint32_t crc = 1u << 31;
    while (n--)
        crc = crc >> 8 ^ crc_table[0][crc & 255];
    return (uint64_t)crc << 1;
}

static void make_crc_tables(void)
{
    for (unsigned value = 0; value < 256; value++) {
        uint32_t crc = value;
        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (0x82f63b78u & -(crc & 1));
        crc_table[0][value] = crc;
    }
    for (unsigned value = 0; value < 256; value++)
        for (int k = 1; k < 8; k++)
            crc_table[k][value] =
                crc_table[k - 1][value] >> 8 ^ crc_table[0][crc_table[k - 1][value] & 255];
    make_past(past_long, LONG_LANE);
    make_past(past_short, SHORT_LANE);
    fold_far[0] = power(FOLDED + 4);
    fold_far[1] = power(FOLDED - 4);
    fold_near[0] = power(FOLDED / 4 + 4);
    fold_near[1] = power(FOLDED / 4 - 4);
}

static uint32_t crc_by_table(uint32_t crc, const uint8_t *p, size_t size)
{
    for (; size >= 8; size -= 8, p += 8) {
        uint32_t a = crc ^ load32(p), b = load32(p + 4);
        crc = crc_table[7][a & 255] ^ crc_table[6][a >> 8 & 255] ^ crc_table[5][a >> 16 & 255]
            ^ crc_table[4][a >> 24] ^ crc_table[3][b & 255] ^ crc_table[2][b >> 8 & 255]
            ^ crc_table[1][b >> 16 & 255] ^ crc_table[0][b >> 24];
    }
    for (; size; size--)
        crc = crc >> 8 ^ crc_table[0][(crc ^ *p++) & 255];
    return crc;
}

#ifdef X86_DISPATCH
INLINE uint32_t pass(const uint32_t table[4][256], uint32_t crc)
{
    return table[0][crc & 255] ^ table[1][crc >> 8 & 255] ^ table[2][crc >> 16 & 255]
         ^ table[3][crc >> 24];
}

__attribute__((target("sse4.2")))
static uint32_t crc_by_instruction(uint32_t crc, const uint8_t *p, size_t size)
{
    for (size_t lane = LONG_LANE; lane >= SHORT_LANE; lane = lane > SHORT_LANE ? SHORT_LANE : 0)
        for (; lane && size >= 3 * lane; size -= 3 * lane, p += 3 * lane) {
            const uint32_t (*table)[256] = lane == LONG_LANE ? past_long : past_short;
            uint64_t a = crc, b = 0, c = 0;
            for (size_t i = 0; i < lane; i += 8) {
                if (i % 64 == 0) {
                    PREFETCH(p + 3 * lane + i);
                    PREFETCH(p + 4 * lane + i);
                    PREFETCH(p + 5 * lane + i);
                }
                a = _mm_crc32_u64(a, load64(p + i));
                b = _mm_crc32_u64(b, load64(p + lane + i));
                c = _mm_crc32_u64(c, load64(p + 2 * lane + i));
            }
            crc = pass(table, pass(table, (uint32_t)a) ^ (uint32_t)b) ^ (uint32_t)c;
        }
    uint64_t state = crc;
    for (; size >= 8; size -= 8, p += 8)
        state = _mm_crc32_u64(state, load64(p));
    crc = (uint32_t)state;
    for (; size >= 4; size -= 4, p += 4)
        crc = _mm_crc32_u32(crc, load32(p));
    for (; size; size--)
        crc = _mm_crc32_u8(crc, *p++);
    return crc;
}

/* Shift remainders of 16 bytes past the bytes between them and `next`, and add them to it. */
AVX512_INLINE __m512i fold(__m512i crc, __m512i past, __m512i next)
{
    return _mm512_ternarylogic_epi64(_mm512_clmulepi64_epi128(crc, past, 0x00),
                                     _mm512_clmulepi64_epi128(crc, past, 0x11), next, 0x96);
}

AVX512 static uint32_t crc_by_folding(uint32_t crc, const uint8_t *p, size_t size)
{
    if (size < FOLDED)
        return crc_by_instruction(crc, p, size);
    const __m512i far = _mm512_broadcast_i32x4(_mm_loadu_si128((const __m128i *)fold_far));
    const __m512i near = _mm512_broadcast_i32x4(_mm_loadu_si128((const __m128i *)fold_near));
    __m512i a = _mm512_loadu_si512(p), b = _mm512_loadu_si512(p + 64);
    __m512i c = _mm512_loadu_si512(p + 128), d = _mm512_loadu_si512(p + 192);
    a = _mm512_xor_si512(a, _mm512_zextsi128_si512(_mm_cvtsi32_si128((int)crc)));
    for (p += FOLDED, size -= FOLDED; size >= FOLDED; p += FOLDED, size -= FOLDED) {
        for (unsigned line = 0; line < FOLDED; line += 64)
            PREFETCH(p + 3 * LONG_LANE + line);
        a = fold(a, far, _mm512_loadu_si512(p));
        b = fold(b, far, _mm512_loadu_si512(p + 64));
        c = fold(c, far, _mm512_loadu_si512(p + 128));
        d = fold(d, far, _mm512_loadu_si512(p + 192));
    }
    d = fold(fold(fold(a, near, b), near, c), near, d);
    for (; size >= 64; p += 64, size -= 64)
        d = fold(d, near, _mm512_loadu_si512(p));
    uint8_t folded[64]; /* has the same remainder as all bytes before p */
    _mm512_storeu_si512(folded, d);
    return crc_by_instruction(crc_by_instruction(0, folded, sizeof folded), p, size);
}
#endif

/* Continue a CRC, whose initial value is ~0 and whose result is the complement of the last one. */
static uint32_t crc_more(uint32_t crc, const uint8_t *p, size_t size)
{
#ifdef X86_DISPATCH
    if (has_avx512)
        return crc_by_folding(crc, p, size);
    if (has_crc_instruction)
        return crc_by_instruction(crc, p, size);
#endif
    return crc_by_table(crc, p, size);
}

static uint32_t crc32c(const uint8_t *p, size_t size) { return ~crc_more(~0u, p, size); }

/* Whether the CRC `crc`, continued over `size` bytes at p, equals the value stored after them. */
static int crc_holds(uint32_t crc, const uint8_t *p, size_t size)
{
    int holds = load32(p + size) == ~crc_more(crc, p, size);
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION /* a fuzzer cannot guess CRCs */
    holds = 1;
#endif
    return holds;
}

/* Must be called once, before anything else. */
static void start_kernels(void)
{
    make_crc_tables();
#ifdef X86_DISPATCH
    has_crc_instruction = __builtin_cpu_supports("sse4.2");
    has_bit_instructions = __builtin_cpu_supports("popcnt") && __builtin_cpu_supports("bmi")
                        && __builtin_cpu_supports("bmi2");
    has_avx2 = __builtin_cpu_supports("avx2");
    has_avx512 = has_bit_instructions && has_crc_instruction && __builtin_cpu_supports("avx512f")
              && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl")
              && __builtin_cpu_supports("avx512vbmi") && __builtin_cpu_supports("avx512vbmi2")
              && __builtin_cpu_supports("vpclmulqdq");
#endif
}
