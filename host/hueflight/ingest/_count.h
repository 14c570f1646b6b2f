/* count: codes of a block of frames into histograms, a tile of pixels at a time.
 *
 * Counting frame by frame scatters into a table that no cache holds. Here the counters of 64
 * pixels stay in the cache while all frames of a block pass by, and go to the table once. */
#ifndef CODE_WIDTHS /* a fuzzer compiles those that it uses */
#define CODE_WIDTHS(X) \
    X(1) X(2) X(3) X(4) X(5) X(6) X(7) X(8) X(9) X(10) X(11) X(12) X(13) X(14) X(15) X(16)
#endif
enum {
    TILE = 64,    /* pixels counted at a time */
    LINE = 64,    /* bytes that come into the cache together */
    AHEAD = 8,    /* frames whose hits are fetched ahead */
    FETCH_MOST = 1 << 18, /* bytes of rows that are fetched ahead: half of a small second cache */
    SLACK = 8,    /* bytes that may be read behind a payload: its packet's trailer is longer */
    MOST_FRAMES = 65535, /* what a tile's counters hold */
    NARROW = 32,    /* codes of a narrow tile: a cache line for each pixel */
    FEW = 16,       /* a narrow tile is for one pixel in so many with a photon */
    GUESS = 64      /* hits by which a narrow tile is placed */
};

typedef struct { const uint8_t *bits, *codes; uint16_t hits, used; } Sparse;
typedef struct { const uint8_t *codes; uint64_t map; uint32_t at, hits; } Piece; /* in one tile */

typedef struct Count Count;
struct Count {
    const uint8_t *data;
    size_t size;
    unsigned pixels, code_bits, run;
    size_t all; /* chunks of a whole frame */
    const uint64_t *chunks;
    size_t stride;
    const uint32_t *chosen; /* frames to count, places in `chunks` */
    size_t frames;
    void *out; /* (pixel, code) of uint16 or uint32 */
    int wide;
    int mode;
    uint8_t *done;   /* (tile,): tiles whose counts are in `out`; others only are added */
    uint16_t *tile, *rows[TILE]; /* counters of the pixels at hand; where each pixel's begin */
    uint16_t *narrow; /* (pixel of a chunk, NARROW) */
    int spread;       /* codes were found not to fit a narrow tile */
    const uint8_t **dense;
    Sparse *sparse, *ordered;
    Piece *found, *sorted;
    size_t dense_count, sparse_count;
    uint64_t photons, clipped;
    size_t pending;
    void (*put)(Count *, Seen, size_t first, unsigned pixels, uint8_t *done);
};

/* The codes from bit `at` of p on, as many as one load gives. */
INLINE uint64_t codes_at(const uint8_t *p, size_t at) { return load64(p + (at >> 3)) >> (at & 7); }

/* `bits` bits of a word from bit `from` on. `fast` says that the processor has bit instructions;
 * it is a constant in each variant of the code, as are the others where this is called. */
INLINE size_t field(uint64_t word, unsigned from, unsigned bits, int fast)
{
#ifdef X86_DISPATCH
    if (fast) { /* one instruction instead of three; compilers don't find it */
        uint64_t value, control = bits << 8 | from;
        __asm__("bextr %2, %1, %0" : "=r"(value) : "r"(word), "r"(control) : "cc");
        return value;
    }
#endif
    (void)fast;
    return word >> from & (((size_t)1 << bits) - 1);
}

/* Count a tile of `pixels` codes, packed without gaps. */
INLINE void count_dense(uint16_t *tile, const uint8_t *p, unsigned pixels, const unsigned bits,
                        const int fast)
{
    const size_t stride = ((size_t)1 << bits) + SPARE, mask = ((size_t)1 << bits) - 1;
    /* Eight codes are `bits` bytes: the first codes come from the load at their start, the others
     * from the load that ends with them. */
    const unsigned behind = bits > 8 ? bits - 8 : 0;
    for (unsigned group = pixels / 8; group; group--, p += bits, tile += 8 * stride) {
        uint64_t a = load64(p), b = load64(p + behind);
#pragma GCC unroll 8
        for (unsigned i = 0; i < 8; i++)
            if ((i + 1) * bits <= 64)
                tile[i * stride + field(a, i * bits, bits, fast)]++;
            else
                tile[i * stride + field(b, i * bits - 8 * behind, bits, fast)]++;
    }
    for (unsigned i = 0; i < pixels % 8; i++, tile += stride)
        tile[codes_at(p, (size_t)i * bits) & mask]++;
}

/* Count `hits` hits of a tile: the ones of `map` are its pixels with a photon, their codes are
 * packed from bit `at` of p on. */
INLINE void count_sparse(uint16_t *const *rows, uint64_t map, const uint8_t *p, size_t at,
                         unsigned hits, const unsigned bits, const int fast)
{
    const unsigned per_load = 57 / bits < 8 ? 57 / bits : 8; /* up to 7 bits are codes before */
    for (; hits >= per_load; hits -= per_load, at += per_load * bits) {
        uint64_t codes = codes_at(p, at);
#pragma GCC unroll 8
        for (unsigned i = 0; i < per_load; i++, map &= map - 1)
            rows[LOWEST_BIT(map)][field(codes, i * bits, bits, fast)]++;
    }
    if (!hits)
        return;
    uint64_t codes = codes_at(p, at);
    for (; hits; hits--, map &= map - 1, codes >>= bits)
        rows[LOWEST_BIT(map)][field(codes, 0, bits, fast)]++;
}

/* Add a tile to the table and clear it. */
INLINE void put_tile(Count *count, Seen seen, size_t first, unsigned pixels, uint8_t *done)
{
    const size_t codes = (size_t)1 << count->code_bits;
    if ((count->mode == SUBTRACT) == *done) {
        int put = count->wide
            ? put_uint32_t((uint32_t *)count->out + first * codes, &seen, pixels, codes,
                           count->frames, count->mode, &count->photons, &count->clipped)
            : put_uint16_t((uint16_t *)count->out + first * codes, &seen, pixels, codes,
                           count->frames, count->mode, &count->photons, &count->clipped);
        count->pending += !put;
        if (put)
            *done = count->mode != SUBTRACT;
    }
    for (unsigned pixel = 0; seen.to && pixel < pixels; pixel++)
        memset(seen.at + pixel * seen.stride, 0, (seen.to - seen.from) * sizeof *seen.at);
}

static void put_plain(Count *count, Seen seen, size_t first, unsigned pixels, uint8_t *done)
{
    put_tile(count, seen, first, pixels, done);
}
#ifdef X86_DISPATCH
__attribute__((target("avx2")))
static void put_with_avx2(Count *count, Seen seen, size_t first, unsigned pixels, uint8_t *done)
{
    put_tile(count, seen, first, pixels, done);
}
#endif

/* Sort the frames' payloads of one chunk by kind. Entries are checked again: they come through
 * Python, and the bytes may belong to a buffer that somebody writes to. */
static int sort_chunk(Count *count, size_t chunk, const Shape *shape)
{
    const uint64_t *entries = count->chunks + chunk * count->stride;
    const uint64_t *next = entries + (chunk + 1 < count->all ? count->stride : 0);
    count->dense_count = count->sparse_count = 0;
    for (size_t i = 0; i < count->frames; i++) {
        uint64_t entry = entries[count->chosen[i]];
        PREFETCH(count->data + (uint32_t)next[count->chosen[i]]);
        PREFETCH(count->data + (uint32_t)next[count->chosen[i]] + LINE);
        if (!entry)
            continue;
        size_t offset = (uint32_t)entry;
        unsigned hits = (uint16_t)(entry >> 32), kind = (unsigned)(entry >> 48);
        if (hits > shape->pixels || (kind != DENSE && kind != BITMAP)
            || offset + payload_bytes(shape, hits, kind) + SLACK > count->size)
            return 0;
        const uint8_t *p = count->data + offset;
        if (kind == DENSE)
            count->dense[count->dense_count++] = p;
        else
            count->sparse[count->sparse_count++] =
                (Sparse){p, p + (shape->pixels + 7) / 8, (uint16_t)hits, 0};
    }
    return 1;
}

/* The rows of a tile's pixels are fetched while it is counted, some lines with each frame. */
typedef struct { const uint8_t *at, *end; size_t lines; } Rows;

INLINE Rows rows_ahead(const Count *count, size_t first, unsigned pixels, size_t steps)
{
    const unsigned shift = count->code_bits + (count->wide ? 2 : 1);
    const uint8_t *at = (const uint8_t *)count->out + (first << shift);
    const size_t bytes = (size_t)pixels << shift;
    return (Rows){at, at + bytes, steps && bytes <= FETCH_MOST ? bytes / LINE / steps + 1 : 0};
}

INLINE void fetch_rows(Rows *rows)
{
    for (size_t i = 0; i < rows->lines && rows->at < rows->end; i++, rows->at += LINE)
        PREFETCH_ROW(rows->at);
}

/* Bytes that the next tile needs are fetched while this one is counted: all frames of a tile lie
 * between, enough for the slowest memory. */
INLINE void count_dense_tile(Count *count, size_t first, unsigned at, unsigned pixels,
                             const unsigned bits, const int fast)
{
    const unsigned tile_bytes = TILE / 8 * bits;
    Rows rows = rows_ahead(count, first + at, pixels, count->dense_count);
    for (size_t i = 0; i < count->dense_count; i++) {
        const uint8_t *p = count->dense[i] + at / 8 * bits;
        for (unsigned next = tile_bytes + LINE / 2; next < 2 * tile_bytes + LINE; next += LINE)
            PREFETCH(p + next);
        fetch_rows(&rows);
        count_dense(count->tile, p, pixels, bits, fast);
    }
}

/* Frames are taken in order of their hits in this tile: a loop whose length changes from frame to
 * frame costs more in wrong guesses of the processor than in counting. */
INLINE unsigned count_sparse_tile(Count *count, size_t first, unsigned at, unsigned pixels,
                                  const unsigned bits, const int fast)
{
    const uint64_t inside = pixels < TILE ? ((uint64_t)1 << pixels) - 1 : ~(uint64_t)0;
    uint32_t place[TILE + 1] = {0};
    unsigned total = 0;
    for (size_t i = 0; i < count->sparse_count; i++) {
        Sparse *sparse = &count->sparse[i];
        uint64_t map = load64(sparse->bits + at / 8) & inside;
        unsigned hits = POPCOUNT(map);
        if (hits > (unsigned)(sparse->hits - sparse->used)) /* never more than the word says */
            hits = (unsigned)(sparse->hits - sparse->used);
        count->found[i] = (Piece){sparse->codes, map, sparse->used * bits, hits};
        sparse->used = (uint16_t)(sparse->used + hits);
        place[hits]++;
    }
    for (unsigned hits = 0; hits <= TILE; hits++) {
        uint32_t here = place[hits];
        place[hits] = total;
        total += here;
    }
    for (size_t i = 0; i < count->sparse_count; i++)
        count->sorted[place[count->found[i].hits]++] = count->found[i];
    Rows rows = rows_ahead(count, first + at, pixels, count->sparse_count - place[0]);
    for (size_t i = place[0]; i < count->sparse_count; i++) {
        const Piece *piece = &count->sorted[i];
        if (i + AHEAD < count->sparse_count)
            PREFETCH_NOW(piece[AHEAD].codes + piece[AHEAD].at / 8);
        fetch_rows(&rows);
        count_sparse(count->rows, piece->map, piece->codes, piece->at, piece->hits, bits, fast);
    }
    return (unsigned)(count->sparse_count - place[0]);
}

/* Where a narrow tile should begin so that it holds the codes of the first hits with some room
 * before them, or -1 if it can't. */
INLINE int narrow_from(const Count *count, const unsigned bits, const int fast)
{
    size_t least = (size_t)1 << bits, most = 0, seen = 0;
    for (size_t i = 0; i < count->sparse_count && seen < GUESS; i++)
        for (unsigned hit = 0; hit < count->sparse[i].hits && seen < GUESS; hit++, seen++) {
            uint64_t codes = codes_at(count->sparse[i].codes, (size_t)hit * bits);
            size_t code = field(codes, 0, bits, fast);
            least = code < least ? code : least;
            most = code > most ? code : most;
        }
    if (!seen || most - least >= NARROW)
        return -1;
    const size_t room = (NARROW - 1 - (most - least)) / 2;
    return (int)(least > room ? (least - room) & ~(size_t)7 : 0);
}

/* Order the frames by hits, so that loops over them have a constant length for long; 0 if one has
 * more than `few`. */
INLINE int order_by_hits(Count *count, unsigned few)
{
    uint32_t place[MAX_RUN / FEW + 2] = {0};
    for (size_t i = 0; i < count->sparse_count; i++) {
        if (count->sparse[i].hits > few)
            return 0;
        place[count->sparse[i].hits]++;
    }
    uint32_t total = 0;
    for (unsigned hits = 0; hits <= few; hits++) {
        uint32_t here = place[hits];
        place[hits] = total;
        total += here;
    }
    for (size_t i = 0; i < count->sparse_count; i++)
        count->ordered[place[count->sparse[i].hits]++] = count->sparse[i];
    return 1;
}

/* Write down the pixels of a bitmap word's ones, in order; how many there are. Four are written
 * whatever the word has, since guessing how many it has goes wrong too often. */
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

INLINE size_t count_near(uint16_t *narrow, unsigned pixel, size_t code)
{
    narrow[pixel * NARROW + code % NARROW]++;
    return code;
}

/* Count a chunk with few hits whose codes lie close together, as behind a gate: the counters of
 * such codes of all its pixels stay in the first cache, and only they go to the table. 0 if a code
 * turned out to lie elsewhere; nothing is counted then. */
INLINE int count_narrow(Count *count, unsigned pixels, size_t from, const unsigned bits,
                        const int fast)
{
    const unsigned per_load = 57 / bits < 8 ? 57 / bits : 8, whole = pixels & ~63u;
    const uint64_t rest = ((uint64_t)1 << pixels % 64) - 1;
    uint16_t pixel[MAX_RUN + 4];
    size_t spread = 0;
    for (size_t i = 0; i < count->sparse_count; i++) {
        const Sparse *sparse = &count->ordered[i];
        if (i + AHEAD < count->sparse_count) {
            PREFETCH_NOW(sparse[AHEAD].bits);
            PREFETCH_NOW(sparse[AHEAD].codes);
        }
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
                spread |= count_near(count->narrow, *at++, code);
            }
        }
        uint64_t codes = hits ? codes_at(p, bit) : 0;
        for (; hits; hits--, codes >>= bits)
            spread |= count_near(count->narrow, *at++, field(codes, 0, bits, fast) - from);
    }
    if (spread < NARROW)
        return 1;
    memset(count->narrow, 0, pixels * NARROW * sizeof *count->narrow);
    return 0;
}

INLINE int put_narrow(Count *count, size_t first, unsigned pixels, size_t from, uint8_t *done)
{
    const size_t codes = (size_t)1 << count->code_bits;
    const size_t to = from + NARROW < codes ? from + NARROW : codes;
    for (unsigned at = 0; at < pixels; at += TILE)
        count->put(count, (Seen){count->narrow + at * NARROW, NARROW, from, to}, first + at,
                   pixels - at < TILE ? pixels - at : TILE, done++);
    return 1;
}

INLINE int count_chunk(Count *count, size_t chunk, const unsigned bits, const int fast)
{
    size_t first = chunk * count->run, left = count->pixels - first;
    Shape shape = chunk_shape(left < count->run ? (unsigned)left : count->run, bits);
    if (!sort_chunk(count, chunk, &shape))
        return 0;
    uint8_t *done = count->done + chunk * ((count->run + TILE - 1) / TILE);
    if (count->sparse_count && !count->dense_count && !count->spread) {
        int from = narrow_from(count, bits, fast);
        if (from >= 0 && order_by_hits(count, shape.pixels / FEW + 1)) {
            if (count_narrow(count, shape.pixels, (size_t)from, bits, fast))
                return put_narrow(count, first, shape.pixels, (size_t)from, done);
            count->spread = 1; /* the next chunks' codes will hardly be closer */
        }
    }
    for (unsigned at = 0; at < shape.pixels; at += TILE, done++) {
        unsigned pixels = shape.pixels - at < TILE ? shape.pixels - at : TILE;
        int touched = count->dense_count > 0;
        if (pixels == TILE)
            count_dense_tile(count, first, at, TILE, bits, fast);
        else
            count_dense_tile(count, first, at, pixels, bits, fast);
        if (count->sparse_count)
            touched |= count_sparse_tile(count, first, at, pixels, bits, fast) > 0;
        count->put(count, (Seen){count->tile, ((size_t)1 << bits) + SPARE, 0,
                                 touched ? (size_t)1 << bits : 0}, first + at, pixels, done);
    }
    return 1;
}

INLINE int count_any(Count *count, size_t chunk, const int fast)
{
    switch (count->code_bits) {
#define X(n) case n: return count_chunk(count, chunk, n, fast);
    CODE_WIDTHS(X)
#undef X
    }
    return 0;
}

static int count_plain(Count *count, size_t chunk) { return count_any(count, chunk, 0); }
#ifdef X86_DISPATCH
__attribute__((target("popcnt,bmi,bmi2")))
static int count_with_bit_instructions(Count *count, size_t chunk)
{
    return count_any(count, chunk, 1);
}
#endif

enum { OK, NO_MEMORY, BAD_CHUNK };

static int count_chunks(Count *count, size_t begin, size_t end)
{
    int (*one)(Count *, size_t) = count_plain;
    count->put = put_plain;
#ifdef X86_DISPATCH
    if (has_bit_instructions)
        one = count_with_bit_instructions;
    if (has_avx2)
        count->put = put_with_avx2;
#endif
    size_t room = count->frames ? count->frames : 1;
    count->all = (count->pixels + count->run - 1) / count->run;
    int result = NO_MEMORY;
    const size_t stride = ((size_t)1 << count->code_bits) + SPARE;
    const size_t rows = count->pixels < TILE ? count->pixels : TILE;
    count->tile = calloc(rows * stride, sizeof(uint16_t));
    count->narrow = calloc((count->run < count->pixels ? count->run : count->pixels) * NARROW,
                           sizeof(uint16_t));
    count->dense = malloc(room * sizeof *count->dense);
    count->sparse = malloc(room * sizeof *count->sparse);
    count->ordered = malloc(room * sizeof *count->ordered);
    count->found = malloc(room * sizeof *count->found);
    count->sorted = malloc(room * sizeof *count->sorted);
    for (size_t row = 0; count->tile && row < rows; row++)
        count->rows[row] = count->tile + row * stride;
    if (count->tile && count->narrow && count->dense && count->sparse && count->ordered
        && count->found && count->sorted) {
        result = OK;
        for (size_t chunk = begin; result == OK && chunk < end; chunk++)
            if (!one(count, chunk))
                result = BAD_CHUNK;
    }
    free(count->tile);
    free(count->narrow);
    free(count->dense);
    free(count->sparse);
    free(count->ordered);
    free(count->found);
    free(count->sorted);
    return result;
}
