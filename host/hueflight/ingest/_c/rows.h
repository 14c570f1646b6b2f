/* SPDX-License-Identifier: Apache-2.0 */
/* Rows of the table: the counts of one pixel, one for each code, 16 or 32 bits wide.
 *
 * The counters of a tile are added to the rows of its pixels in a single pass; a second pass would
 * have to wait for the stores of the first. Code 0 receives the frames without a code: those in
 * which the sensor reports no photon, and those whose code the camera did not send. */
enum {
    SPARE = 16, /* unused counters per pixel: a power of two as stride gives cache conflicts */
    ROWS_WINDOW = 32, /* codes of a window (see window_counters.h) */
    ROWS_AHEAD = 24 /* prefetch distance, in rows of the table */
};
#define NO_PHOTON(seen, from, to) ((from) == 0 && (to) > 0 ? (seen)[0] : 0) /* of code 0 */

typedef struct { uint16_t *at; size_t stride, from, to; } Seen; /* counters of codes from..to-1 */

/* The functions of one row return the photons of the pixel, which are exact because a tile counts
 * at most 65 535 frames. `put` returns whether the tile was added to the table: if a counter would
 * overflow, ADD leaves the table as it was, and only then is there a second pass. Rows are far
 * apart, so that the hardware prefetcher does not fetch the parts that few photons reach. */
#define DEFINE_ROWS(word, largest) \
INLINE uint16_t store_##word(word *restrict row, const uint16_t *restrict seen, size_t codes, \
                             size_t from, size_t to, size_t frames) \
{ \
    uint16_t sum = 0; \
    memset(row, 0, from * sizeof *row); \
    for (size_t code = from; code < to; code++) { \
        sum = (uint16_t)(sum + seen[code - from]); \
        row[code] = seen[code - from]; \
    } \
    memset(row + to, 0, (codes - to) * sizeof *row); \
    const uint16_t photons = (uint16_t)(sum - NO_PHOTON(seen, from, to)); \
    row[0] = (word)(frames - photons); \
    return photons; \
} \
INLINE uint16_t add_##word(word *restrict row, const uint16_t *restrict seen, size_t from, \
                           size_t to, size_t frames, unsigned *over) \
{ \
    const word first = row[0]; \
    uint16_t sum = 0; \
    word carry = 0; \
    for (size_t code = from; code < to; code++) { \
        const word more = (word)(row[code] + seen[code - from]); \
        sum = (uint16_t)(sum + seen[code - from]); \
        carry |= more < seen[code - from]; \
        row[code] = more; \
    } \
    const uint16_t photons = (uint16_t)(sum - NO_PHOTON(seen, from, to)); \
    const uint16_t rest = (uint16_t)(frames - photons); \
    row[0] = (word)(first + rest); \
    *over |= carry || row[0] < rest; \
    return photons; \
} \
INLINE uint16_t subtract_##word(word *restrict row, const uint16_t *restrict seen, size_t from, \
                                size_t to, size_t frames) \
{ \
    const word first = row[0]; \
    uint16_t sum = 0; \
    for (size_t code = from; code < to; code++) { \
        sum = (uint16_t)(sum + seen[code - from]); \
        row[code] = (word)(row[code] - seen[code - from]); \
    } \
    const uint16_t photons = (uint16_t)(sum - NO_PHOTON(seen, from, to)); \
    row[0] = (word)(first - (uint16_t)(frames - photons)); \
    return photons; \
} \
INLINE void saturate_##word(word *restrict row, const uint16_t *restrict seen, size_t from, \
                            size_t to, size_t frames, uint64_t *clipped) \
{ \
    const word room = (word)(largest - row[0]); \
    uint16_t sum = 0, lost = 0; \
    for (size_t code = from ? from : 1; code < to; code++) { \
        const uint16_t more = seen[code - from]; \
        const word left = (word)(largest - row[code]); \
        const uint16_t taken = more < left ? more : (uint16_t)left; \
        sum = (uint16_t)(sum + more); \
        lost = (uint16_t)(lost + more - taken); \
        row[code] = (word)(row[code] + taken); \
    } \
    const uint16_t rest = (uint16_t)(frames - sum), kept = rest < room ? rest : (uint16_t)room; \
    row[0] = (word)(row[0] + kept); \
    *clipped += (uint64_t)lost + (uint64_t)(rest - kept); \
} \
INLINE int put_codes_##word(word *rows, const Seen *tile, const size_t from, const size_t to, \
                            unsigned pixels, size_t codes, size_t frames, int mode, \
                            uint64_t *photons, uint64_t *clipped) \
{ \
    uint64_t sum = 0; \
    unsigned over = 0; \
    for (unsigned i = 0; i < pixels; i++) { \
        word *row = rows + i * codes; \
        const uint16_t *seen = tile->at + i * tile->stride; \
        PREFETCH_ROW(row + ROWS_AHEAD * codes); \
        if (to) { \
            PREFETCH_ROW(row + ROWS_AHEAD * codes + from); \
            PREFETCH_ROW(row + ROWS_AHEAD * codes + to - 1); \
        } \
        sum += mode == STORE ? store_##word(row, seen, codes, from, to, frames) \
             : mode == SUBTRACT ? subtract_##word(row, seen, from, to, frames) \
                                : add_##word(row, seen, from, to, frames, &over); \
    } \
    for (unsigned i = 0; over && i < pixels; i++) { \
        word *row = rows + i * codes; \
        const uint16_t *seen = tile->at + i * tile->stride; \
        subtract_##word(row, seen, from, to, frames); \
        if (mode == SATURATE) \
            saturate_##word(row, seen, from, to, frames, clipped); \
    } \
    if (over && mode == ADD) \
        return 0; \
    *photons += sum; \
    return 1; \
} \
/* Loops of constant length for the common lengths. */ \
INLINE int put_##word(word *rows, const Seen *tile, unsigned pixels, size_t codes, \
                      size_t frames, int mode, uint64_t *photons, uint64_t *clipped) \
{ \
    const size_t from = tile->from, to = tile->to; \
    return !to ? put_codes_##word(rows, tile, 0, 0, pixels, codes, frames, mode, photons, clipped) \
        : to == from + ROWS_WINDOW \
            ? put_codes_##word(rows, tile, from, from + ROWS_WINDOW, pixels, codes, frames, mode, \
                               photons, clipped) \
            : put_codes_##word(rows, tile, from, to, pixels, codes, frames, mode, photons, \
                               clipped); \
}
DEFINE_ROWS(uint16_t, UINT16_MAX)
DEFINE_ROWS(uint32_t, UINT32_MAX)
