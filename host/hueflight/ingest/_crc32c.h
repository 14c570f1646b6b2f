/* CRC-32C (Castagnoli), as RFC 3720 appendix B.4 has it.
 *
* Slices of eight bytes by table; where the processor has the crc32 instruction, three streams of
 * it at once, because one stream waits three clocks for each result. The three remainders are
 * joined by moving a remainder past LANE zero bytes, which is linear: one table per byte of it. */

enum { LONG_LANE = 1024, SHORT_LANE = 128 };
static uint32_t crc_table[8][256], past_long[4][256], past_short[4][256];

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
    return crc_by_table((uint32_t)state, p, size);
}
#endif

/* Go on with a CRC whose first value is ~0 and whose result is the complement of its last. */
static uint32_t crc_more(uint32_t crc, const uint8_t *p, size_t size)
{
#ifdef X86_DISPATCH
    if (has_crc_instruction)
        return crc_by_instruction(crc, p, size);
#endif
    return crc_by_table(crc, p, size);
}

static uint32_t crc32c(const uint8_t *p, size_t size) { return ~crc_more(~0u, p, size); }

/* Whether a CRC that has come to `crc` ends, with the bytes at p, in the value stored there. */
static int crc_holds(uint32_t crc, const uint8_t *p, size_t size)
{
    int holds = load32(p + size) == ~crc_more(crc, p, size);
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION /* a fuzzer can't guess CRCs */
    holds = 1;
#endif
    return holds;
}

/* Call once, before anything else. */
static void start_kernels(void)
{
    make_crc_tables();
#ifdef X86_DISPATCH
    has_crc_instruction = __builtin_cpu_supports("sse4.2");
    has_bit_instructions = __builtin_cpu_supports("popcnt") && __builtin_cpu_supports("bmi")
                        && __builtin_cpu_supports("bmi2");
    has_avx2 = __builtin_cpu_supports("avx2");
#endif
}
