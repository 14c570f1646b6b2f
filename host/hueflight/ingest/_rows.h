/* Rows of the table: a pixel's counts, one for each code, 16 or 32 bits wide.
 *
 * A tile's counters go to its pixels' rows in one pass: a second one over what the first has
 * written would have to wait until the memory has taken it. Code 0 is where frames without a code
 * go: the camera's "no photon", and the codes that it did not send. */
enum {
    SPARE = 16 /* counters between two pixels' in a tile: powers of two collide in the cache */
};
enum { ADD, STORE, SATURATE, SUBTRACT };

/* The functions of one row return the pixel's photons, which are exact: a tile sees at most 65 535
 * frames. `put` returns whether the tile is in the table: ADD leaves it as it was if a counter
 * would not hold its sum, and only then is the tile gone through again. */
#define DEFINE_ROWS(word, largest) \
INLINE uint16_t store_##word(word *restrict row, const uint16_t *restrict seen, size_t codes, \
                             size_t used, size_t frames) \
{ \
    uint16_t sum = 0; \
    for (size_t code = 0; code < used; code++) { \
        sum = (uint16_t)(sum + seen[code]); \
        row[code] = seen[code]; \
    } \
    memset(row + used, 0, (codes - used) * sizeof *row); \
    const uint16_t photons = (uint16_t)(sum - seen[0]); \
    row[0] = (word)(frames - photons); \
    return photons; \
} \
INLINE uint16_t add_##word(word *restrict row, const uint16_t *restrict seen, size_t used, \
                           size_t frames, unsigned *over) \
{ \
    const word first = row[0]; \
    uint16_t sum = 0; \
    word carry = 0; \
    for (size_t code = 0; code < used; code++) { \
        const word more = (word)(row[code] + seen[code]); \
        sum = (uint16_t)(sum + seen[code]); \
        carry |= more < seen[code]; \
        row[code] = more; \
    } \
    const uint16_t photons = (uint16_t)(sum - seen[0]), rest = (uint16_t)(frames - photons); \
    row[0] = (word)(first + rest); \
    *over |= carry || row[0] < rest; \
    return photons; \
} \
INLINE uint16_t subtract_##word(word *restrict row, const uint16_t *restrict seen, size_t used, \
                                size_t frames) \
{ \
    const word first = row[0]; \
    uint16_t sum = 0; \
    for (size_t code = 0; code < used; code++) { \
        sum = (uint16_t)(sum + seen[code]); \
        row[code] = (word)(row[code] - seen[code]); \
    } \
    const uint16_t photons = (uint16_t)(sum - seen[0]); \
    row[0] = (word)(first - (uint16_t)(frames - photons)); \
    return photons; \
} \
INLINE void saturate_##word(word *restrict row, const uint16_t *restrict seen, size_t used, \
                            size_t frames, uint64_t *clipped) \
{ \
    const word room = (word)(largest - row[0]); \
    uint16_t sum = 0, lost = 0; \
    for (size_t code = 1; code < used; code++) { \
        const word left = (word)(largest - row[code]); \
        const uint16_t taken = seen[code] < left ? seen[code] : (uint16_t)left; \
        sum = (uint16_t)(sum + seen[code]); \
        lost = (uint16_t)(lost + seen[code] - taken); \
        row[code] = (word)(row[code] + taken); \
    } \
    const uint16_t rest = (uint16_t)(frames - sum), kept = rest < room ? rest : (uint16_t)room; \
    row[0] = (word)(row[0] + kept); \
    *clipped += (uint64_t)lost + (uint64_t)(rest - kept); \
} \
INLINE int put_##word(word *rows, const uint16_t *tile, unsigned pixels, size_t codes, \
                      size_t used, size_t frames, int mode, uint64_t *photons, uint64_t *clipped) \
{ \
    const size_t stride = codes + SPARE; \
    uint64_t sum = 0; \
    unsigned over = 0; \
    for (unsigned i = 0; i < pixels; i++) { \
        word *row = rows + i * codes; \
        const uint16_t *seen = tile + i * stride; \
        sum += mode == STORE ? store_##word(row, seen, codes, used, frames) \
             : mode == SUBTRACT ? subtract_##word(row, seen, used, frames) \
                                : add_##word(row, seen, used, frames, &over); \
    } \
    for (unsigned i = 0; over && i < pixels; i++) { \
        word *row = rows + i * codes; \
        const uint16_t *seen = tile + i * stride; \
        subtract_##word(row, seen, used, frames); \
        if (mode == SATURATE) \
            saturate_##word(row, seen, used, frames, clipped); \
    } \
    if (over && mode == ADD) \
        return 0; \
    *photons += sum; \
    return 1; \
}
DEFINE_ROWS(uint16_t, UINT16_MAX)
DEFINE_ROWS(uint32_t, UINT32_MAX)
