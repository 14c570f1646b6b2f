/* SPDX-License-Identifier: Apache-2.0 */
/* Window counters: in a chunk with few hits whose codes lie close together, as behind a time gate,
 * only a window of codes is counted, for all pixels of the chunk at once. This touches one cache
 * line of counters and a few lines of the table for each pixel. */
enum {
    WINDOW_CODES = ROWS_WINDOW, /* codes of a window: a cache line for each pixel */
    FEW = 16,    /* a window is used if at most one pixel in FEW has a photon */
    GUESS = 64,  /* hits from which the place of the window is estimated */
    ROWS_KEPT = 512 /* rows whose prefetched lines still fit into the level-2 cache */
};

/* First code of a window that holds the codes of the first hits, centred on them, or -1 if they are
 * too far apart. */
INLINE int window_start(const Count *count, const unsigned bits, const int fast)
{
    size_t least = (size_t)1 << bits, most = 0, seen = 0;
    for (size_t i = 0; i < count->sparse_count && seen < GUESS; i++)
        for (unsigned hit = 0; hit < count->sparse[i].hits && seen < GUESS; hit++, seen++) {
            uint64_t codes = codes_at(count->sparse[i].codes, (size_t)hit * bits);
            size_t code = field(codes, 0, bits, fast);
            least = code < least ? code : least;
            most = code > most ? code : most;
        }
    if (!seen || most - least >= WINDOW_CODES)
        return -1;
    const size_t room = (WINDOW_CODES - 1 - (most - least)) / 2;
    return (int)(least > room ? (least - room) & ~(size_t)7 : 0);
}

/* Sort the frames by hits, so that the length of the loop over hits rarely changes. */
INLINE void order_by_hits(Count *count)
{
    uint32_t place[MAX_RUN / FEW + 2] = {0};
    for (size_t i = 0; i < count->sparse_count; i++)
        place[count->sparse[i].hits]++;
    uint32_t total = 0;
    for (unsigned hits = 0; hits <= count->most_hits; hits++) {
        uint32_t here = place[hits];
        place[hits] = total;
        total += here;
    }
    for (size_t i = 0; i < count->sparse_count; i++)
        count->ordered[place[count->sparse[i].hits]++] = count->sparse[i];
}

/* The lines of the table that the window will be added to are prefetched while it is counted, a few
 * with each frame. */
typedef struct { const uint8_t *at, *end; size_t apart, window, window_end, rows; } Lines;

INLINE Lines lines_ahead(const Count *count, size_t first, unsigned pixels, size_t from)
{
    const unsigned word = count->wide ? 4 : 2;
    const size_t apart = (size_t)word << count->code_bits;
    const uint8_t *at = (const uint8_t *)count->out + first * apart;
    return (Lines){at, at + pixels * apart, apart, from * word, (from + WINDOW_CODES) * word - 1,
                   pixels <= ROWS_KEPT ? pixels / (count->sparse_count + 1) + 1 : 0};
}

INLINE void fetch_lines(Lines *lines)
{
    for (size_t i = 0; i < lines->rows && lines->at < lines->end; i++, lines->at += lines->apart) {
        PREFETCH_ROW(lines->at);
        PREFETCH_ROW(lines->at + lines->window);
        PREFETCH_ROW(lines->at + lines->window_end);
    }
}

/* Store the pixels of the ones in a bitmap word, in order, and return their number. Four are always
 * written, because a branch on their number would often be mispredicted. */
INLINE unsigned pixels_of(uint64_t map, unsigned first, uint16_t *found)
{
    const uint64_t top = (uint64_t)1 << 63;
    const unsigned ones = POPCOUNT(map);
    for (unsigned i = 0; i < 4; i++, map &= map - 1) {
        found[i] = (uint16_t)(first + LOWEST_BIT(map | top));
        ONE_BY_ONE();
    }
    for (unsigned i = 4; i < ones; i++, map &= map - 1)
        found[i] = (uint16_t)(first + LOWEST_BIT(map));
    return ones;
}

INLINE size_t count_near(uint16_t *window, unsigned pixel, size_t code)
{
    window[pixel * WINDOW_CODES + code % WINDOW_CODES]++;
    return code;
}

/* Count the codes of a chunk from `from` on; the counters stay in the level-1 cache. Return whether
 * all codes lay in the window. */
INLINE int count_window(Count *count, Lines lines, unsigned pixels, size_t from,
                        const unsigned bits, const int fast)
{
    const unsigned per_load = 57 / bits < 8 ? 57 / bits : 8, whole = pixels & ~63u;
    const uint64_t rest = ((uint64_t)1 << pixels % 64) - 1;
    uint16_t pixel[MAX_RUN + 4];
    size_t spread = 0;
    order_by_hits(count);
    for (size_t i = 0; i < count->sparse_count; i++) {
        const Sparse *sparse = &count->ordered[i];
        if (i + AHEAD < count->sparse_count) {
            PREFETCH_NOW(sparse[AHEAD].bits);
            PREFETCH_NOW(sparse[AHEAD].codes);
        }
        fetch_lines(&lines);
        unsigned hits = 0;
        for (unsigned first = 0; first < whole; first += 64)
            hits += pixels_of(load64(sparse->bits + first / 8), first, pixel + hits);
        if (rest)
            hits += pixels_of(load64(sparse->bits + whole / 8) & rest, whole, pixel + hits);
        hits = hits < sparse->hits ? hits : sparse->hits;
        const uint16_t *at = pixel;
        const uint8_t *p = sparse->codes;
        size_t bit = 0;
        for (; hits >= per_load; hits -= per_load, bit += per_load * bits) {
            uint64_t codes = codes_at(p, bit);
#pragma GCC unroll 8
            for (unsigned hit = 0; hit < per_load; hit++) {
                const size_t code = field(codes, hit * bits, bits, fast) - from;
                spread |= count_near(count->window, *at++, code);
            }
        }
        uint64_t codes = hits ? codes_at(p, bit) : 0;
        for (; hits; hits--, codes >>= bits)
            spread |= count_near(count->window, *at++, field(codes, 0, bits, fast) - from);
    }
    return spread < WINDOW_CODES;
}

#ifdef X86_DISPATCH
/* The same with vectors: the ones of a bitmap word are found in one step, and 32 codes are unpacked
 * in one step. Both are collected over several frames and then counted together, so that no loop
 * depends on the number of hits in a single frame. */
enum {
    LANES = 32,   /* hits in a vector */
    LISTED = 512, /* hits that are counted together */
    WIDEST = 65536 / WINDOW_CODES /* pixels of a chunk whose counters 16 bits can tell apart */
};
typedef struct {
    uint16_t pixel[LISTED + WIDEST + 2 * LANES], code[LISTED + WIDEST / FEW + 1 + LANES];
    unsigned hits;
} Listed;
static const uint8_t IOTA[64] = {
    0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21,
    22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41, 42, 43,
    44, 45, 46, 47, 48, 49, 50, 51, 52, 53, 54, 55, 56, 57, 58, 59, 60, 61, 62, 63,
};

/* Store the pixels of the ones in a bitmap word (bit 0 is pixel `first`); return their number. */
AVX512_INLINE unsigned list_pixels(uint64_t map, __m512i first, uint16_t *pixel)
{
    __m512i found = _mm512_setzero_si512();
    __asm__("" : "+v"(found)); /* removes a false dependency on the register's old value */
    found = _mm512_mask_compress_epi8(found, map, _mm512_loadu_si512(IOTA));
    const unsigned ones = POPCOUNT(map);
    const __m256i some = _mm256_cvtepu8_epi16(_mm512_castsi512_si128(found));
    _mm256_storeu_si256((__m256i *)pixel, _mm256_add_epi16(some, _mm512_castsi512_si256(first)));
    if (__builtin_expect(ones > 16, 0)) {
        const __m512i low = _mm512_cvtepu8_epi16(_mm512_castsi512_si256(found));
        const __m512i high = _mm512_cvtepu8_epi16(_mm512_extracti64x4_epi64(found, 1));
        _mm512_storeu_si512(pixel, _mm512_add_epi16(low, first));
        _mm512_storeu_si512(pixel + LANES, _mm512_add_epi16(high, first));
    }
    return ones;
}

/* Store `hits` codes, packed from p on. The bits of a code lie within three bytes. */
AVX512_INLINE void list_codes(const uint8_t *p, unsigned hits, unsigned bits, uint16_t *code)
{
    const __m512i lane = _mm512_cvtepu8_epi16(_mm256_loadu_si256((const __m256i *)IOTA));
    const __m512i at = _mm512_mullo_epi16(lane, _mm512_set1_epi16((short)bits));
    const __m512i byte = _mm512_mullo_epi16(_mm512_srli_epi16(at, 3), _mm512_set1_epi16(0x101));
    const __m512i low = _mm512_add_epi8(byte, _mm512_set1_epi16(0x100));
    const __m512i high = _mm512_add_epi8(byte, _mm512_set1_epi16(0x302));
    const __m512i shift = _mm512_and_si512(at, _mm512_set1_epi16(7));
    const __m512i mask = _mm512_set1_epi16((short)((1u << bits) - 1));
    for (unsigned hit = 0; hit < hits; hit += LANES, p += LANES / 8 * bits) {
        const unsigned left = hits - hit < LANES ? hits - hit : LANES;
        const __mmask64 there = _bzhi_u64(~(uint64_t)0, (left * bits + 7) / 8);
        const __m512i bytes = _mm512_maskz_loadu_epi8(there, p);
        const __m512i codes = _mm512_shrdv_epi16(_mm512_permutexvar_epi8(low, bytes),
                                                 _mm512_permutexvar_epi8(high, bytes), shift);
        _mm512_storeu_si512(code + hit, _mm512_and_si512(codes, mask));
    }
}

/* Count the collected hits; return whether all codes lay in the window. */
AVX512_INLINE int count_listed(uint16_t *window, Listed *listed, size_t from)
{
    const __m512i last = _mm512_set1_epi16(WINDOW_CODES - 1);
    const __m512i start = _mm512_set1_epi16((short)from);
    __mmask32 spread = 0;
    for (unsigned hit = 0; hit < listed->hits; hit += LANES) {
        const __m512i code = _mm512_sub_epi16(_mm512_loadu_si512(listed->code + hit), start);
        const __m512i row = _mm512_slli_epi16(_mm512_loadu_si512(listed->pixel + hit), 5);
        const __mmask32 there = (__mmask32)_bzhi_u64(~(uint64_t)0, listed->hits - hit);
        spread |= _mm512_mask_cmpgt_epu16_mask(there, code, last);
        _mm512_storeu_si512(listed->pixel + hit,
                            _mm512_or_si512(row, _mm512_and_si512(code, last)));
    }
#pragma GCC unroll 8
    for (unsigned hit = 0; hit < listed->hits; hit++)
        window[listed->pixel[hit]]++;
    listed->hits = 0;
    return !spread;
}

AVX512 static int count_window_with_avx512(Count *count, Lines lines, unsigned pixels, size_t from)
{
    const unsigned whole = pixels & ~63u;
    const uint64_t rest = ((uint64_t)1 << pixels % 64) - 1;
    Listed listed;
    listed.hits = 0;
    int fits = 1;
    for (size_t i = 0; i < count->sparse_count; i++) {
        const Sparse *sparse = &count->sparse[i];
        if (i + AHEAD < count->sparse_count) {
            PREFETCH_NOW(sparse[AHEAD].bits);
            PREFETCH_NOW(sparse[AHEAD].codes);
        }
        fetch_lines(&lines);
        const uint8_t *word = sparse->bits, *end = word + whole / 8;
        uint16_t *pixel = listed.pixel + listed.hits;
        __m512i first = _mm512_setzero_si512();
#pragma GCC unroll 8
        for (; word < end; word += 8, first = _mm512_add_epi16(first, _mm512_set1_epi16(64)))
            pixel += list_pixels(load64(word), first, pixel);
        if (rest)
            pixel += list_pixels(load64(word) & rest, first, pixel);
        unsigned hits = (unsigned)(pixel - listed.pixel) - listed.hits;
        hits = hits < sparse->hits ? hits : sparse->hits;
        list_codes(sparse->codes, hits, count->code_bits, listed.code + listed.hits);
        listed.hits += hits;
        if (listed.hits >= LISTED)
            fits &= count_listed(count->window, &listed, from);
    }
    return fits & count_listed(count->window, &listed, from);
}
#endif

/* Count a chunk with window counters and add them to the table, or do nothing and return 0 if its
 * codes are too far apart. */
INLINE int count_in_window(Count *count, size_t first, unsigned pixels, uint8_t *done,
                        const unsigned bits, const int fast)
{
    const int start = count->most_hits <= pixels / FEW + 1 ? window_start(count, bits, fast) : -1;
    if (start < 0)
        return 0;
    const size_t from = (size_t)start, codes = (size_t)1 << bits;
    const size_t to = from + WINDOW_CODES < codes ? from + WINDOW_CODES : codes;
    const Lines lines = lines_ahead(count, first, pixels, from);
    Put *put = count->put;
    int fits;
#ifdef X86_DISPATCH
    if (has_avx512 && pixels <= WIDEST) {
        fits = count_window_with_avx512(count, lines, pixels, from);
        put = put_with_avx512;
    } else
#endif
        fits = count_window(count, lines, pixels, from, bits, fast);
    for (unsigned at = 0; fits && at < pixels; at += TILE)
        put(count, (Seen){count->window + at * WINDOW_CODES, WINDOW_CODES, from, to}, first + at,
            pixels - at < TILE ? pixels - at : TILE, done++);
    for (unsigned pixel = 0; pixel < pixels; pixel++)
        memset(count->window + pixel * WINDOW_CODES, 0, WINDOW_CODES * sizeof *count->window);
    count->spread = !fits; /* the codes of the next chunks are unlikely to be closer */
    return fits;
}
