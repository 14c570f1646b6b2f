/* SPDX-License-Identifier: Apache-2.0 */
/* Tiles: the counters of 64 pixels stay in the cache while all frames of a block are counted, and
 * are then added to the table once. Counting frame by frame would scatter into a table that is
 * larger than any cache. */
enum {
    LINE = 64,    /* bytes of a cache line */
    AHEAD = 8,    /* prefetch distance, in frames */
    FETCH_MOST = 1 << 18, /* bytes of rows that are prefetched: half of a small level-2 cache */
    SLACK = 8     /* bytes that may be read past a payload: the trailer of its packet is longer */
};

typedef struct { const uint8_t *bits, *codes; uint16_t hits, used; } Sparse;
typedef struct { const uint8_t *codes; uint64_t map; uint32_t at, hits; } Piece; /* in one tile */

typedef struct Count Count;
typedef void Put(Count *, Seen, size_t first, unsigned pixels, uint8_t *done);
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
    uint8_t *done;   /* (tile,): tiles that are already in `out`; only the others are added */
    uint16_t *tile, *rows[TILE]; /* counters of the pixels at hand; where each pixel's begin */
    uint16_t *window; /* (pixel of a chunk, WINDOW_CODES): see window_counters.h */
    int spread;       /* the codes of a chunk did not fit into a window */
    const uint8_t **dense;
    Sparse *sparse, *ordered;
    Piece *found, *sorted;
    size_t dense_count, sparse_count;
    unsigned most_hits; /* of a sparse one */
    uint64_t photons, clipped;
    size_t pending;
    Put *put;
};

/* The codes from bit `at` of p on, as many as one load holds. */
INLINE uint64_t codes_at(const uint8_t *p, size_t at) { return load64(p + (at >> 3)) >> (at & 7); }

/* `bits` bits of a word from bit `from` on. `fast` says that the processor has bit instructions;
 * it is a constant in each variant of the code, as are `from` and `bits` at every call. */
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

/* A call, since compilers clear a constant length word by word. */
__attribute__((noinline)) static void clear_row(uint16_t *row, size_t codes)
{
    memset(row, 0, codes * sizeof *row);
}

/* Add a tile to the table. */
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
/* for windows only: 256-bit loads are faster for whole rows */
AVX512 static void put_with_avx512(Count *count, Seen seen, size_t first, unsigned pixels,
                                   uint8_t *done)
{
    put_tile(count, seen, first, pixels, done);
}
#endif

/* Sort the frames' payloads of one chunk by kind. Entries are checked again, because
 * they come through Python and the bytes may belong to a buffer that is being written to. */
static int sort_chunk(Count *count, size_t chunk, const Shape *shape)
{
    const uint64_t *entries = count->chunks + chunk * count->stride;
    const uint64_t *next = entries + (chunk + 1 < count->all ? count->stride : 0);
    const uint8_t *data = count->data, **dense = count->dense;
    Sparse *sparse = count->sparse;
    const size_t size = count->size, map_bytes = (shape->pixels + 7) / 8;
    unsigned most_hits = 0;
    for (size_t i = 0; i < count->frames; i++) {
        const uint64_t entry = entries[count->chosen[i]];
        PREFETCH(data + (uint32_t)next[count->chosen[i]]);
        PREFETCH(data + (uint32_t)next[count->chosen[i]] + LINE);
        if (!entry)
            continue;
        size_t offset = (uint32_t)entry;
        unsigned hits = (uint16_t)(entry >> HITS_SHIFT), kind = (unsigned)(entry >> KIND_SHIFT);
        if (hits > shape->pixels || (kind != DENSE && kind != BITMAP)
            || offset + payload_bytes(shape, hits, kind) + SLACK > size)
            return 0;
        const uint8_t *p = data + offset;
        if (kind == DENSE)
            *dense++ = p;
        else {
            *sparse++ = (Sparse){p, p + map_bytes, (uint16_t)hits, 0};
            most_hits = hits > most_hits ? hits : most_hits;
        }
    }
    count->dense_count = (size_t)(dense - count->dense);
    count->sparse_count = (size_t)(sparse - count->sparse);
    count->most_hits = most_hits;
    return 1;
}

/* The rows of a tile are prefetched while the tile is counted, a few lines with each frame. */
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

/* The payload bytes of the next tile are prefetched while this one is counted: the time for all
 * frames of a tile is long enough for the slowest memory. */
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

/* Frames are sorted by their hits in this tile: if the length of the loop changed from frame to
 * frame, mispredicted branches would cost more than counting. */
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
        if (hits > (unsigned)(sparse->hits - sparse->used)) /* never more than announced */
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

