/* SPDX-License-Identifier: Apache-2.0 */
/* Sums over the histograms of a stream; numpy_gather.py holds the definitions.
 *
 *   group_counts  counts of each tile of pixels in groups of codes, by which changes are told;
 *   gather        a sum with the newest histogram added, or that alone where a tile begins anew. */

typedef struct {
    const void *histogram; /* (row, col, code) */
    size_t rows, cols, codes;
    size_t group; /* codes */
    int wide, leave_first; /* counts of 32 bits; code 0 means that there was no photon */
    void *room; /* sums of a tile, one for each code, 64 bits wide */
    double *out; /* (tile row, tile col, group) */
} GroupCounts;

/* Tiles at the right and the lower edge may have fewer pixels. `sum` holds 16 counts of `word`. */
#define DEFINE_GROUP_COUNTS(word, sum) \
INLINE void group_counts_##word(const GroupCounts *g) \
{ \
    const word *histogram = g->histogram; \
    const size_t codes = g->codes; \
    sum *restrict room = g->room; \
    double *out = g->out; \
    for (size_t row = 0; row < g->rows; row += SCENE_TILE) \
        for (size_t col = 0; col < g->cols; col += SCENE_TILE) { \
            memset(room, 0, codes * sizeof *room); \
            for (size_t r = row; r < g->rows && r < row + SCENE_TILE; r++) \
                for (size_t c = col; c < g->cols && c < col + SCENE_TILE; c++) { \
                    const word *restrict counts = histogram + (r * g->cols + c) * codes; \
                    for (size_t code = 0; code < codes; code++) \
                        room[code] += counts[code]; \
                } \
            if (g->leave_first) \
                room[0] = 0; \
            for (size_t code = 0; code < codes; code += g->group) { \
                sum total = 0; \
                for (size_t i = code; i < codes && i < code + g->group; i++) \
                    total += room[i]; \
                *out++ = (double)total; \
            } \
        } \
}
DEFINE_GROUP_COUNTS(uint16_t, uint32_t)
DEFINE_GROUP_COUNTS(uint32_t, uint64_t)
#undef DEFINE_GROUP_COUNTS

INLINE void group_counts_any(const GroupCounts *g)
{
    if (g->wide)
        group_counts_uint32_t(g);
    else
        group_counts_uint16_t(g);
}

typedef struct {
    const void *total, *histogram; /* (row, col, code) */
    const uint8_t *anew; /* (tile row, tile col) */
    size_t rows, cols, codes;
    int total_wide, histogram_wide, out_wide; /* 32 bits, otherwise 16 */
    void *out; /* may be `total` */
} Gather;

#define DEFINE_GATHER(old, new, word) \
INLINE void gather_##old##_##new##_##word(const Gather *g) \
{ \
    const size_t across = (g->cols + SCENE_TILE - 1) / SCENE_TILE, codes = g->codes; \
    for (size_t row = 0; row < g->rows; row++) \
        for (size_t col = 0; col < g->cols; col++) { \
            const size_t at = (row * g->cols + col) * codes; \
            const old *total = (const old *)g->total + at; \
            const new *restrict counts = (const new *)g->histogram + at; \
            word *out = (word *)g->out + at; \
            if (g->anew[row / SCENE_TILE * across + col / SCENE_TILE]) \
                for (size_t code = 0; code < codes; code++) \
                    out[code] = (word)counts[code]; \
            else \
                for (size_t code = 0; code < codes; code++) \
                    out[code] = (word)((word)total[code] + (word)counts[code]); \
        } \
}
DEFINE_GATHER(uint16_t, uint16_t, uint16_t)
DEFINE_GATHER(uint16_t, uint16_t, uint32_t)
DEFINE_GATHER(uint16_t, uint32_t, uint16_t)
DEFINE_GATHER(uint16_t, uint32_t, uint32_t)
DEFINE_GATHER(uint32_t, uint16_t, uint32_t)
DEFINE_GATHER(uint32_t, uint32_t, uint32_t)
#undef DEFINE_GATHER

INLINE void gather_any(const Gather *g)
{
    if (g->total_wide)
        (g->histogram_wide ? gather_uint32_t_uint32_t_uint32_t
                           : gather_uint32_t_uint16_t_uint32_t)(g);
    else if (g->out_wide)
        (g->histogram_wide ? gather_uint16_t_uint32_t_uint32_t
                           : gather_uint16_t_uint16_t_uint32_t)(g);
    else
        (g->histogram_wide ? gather_uint16_t_uint32_t_uint16_t
                           : gather_uint16_t_uint16_t_uint16_t)(g);
}

static void group_counts_plain(const GroupCounts *g) { group_counts_any(g); }
static void gather_plain(const Gather *g) { gather_any(g); }
#ifdef X86_DISPATCH
__attribute__((target("avx2"))) static void group_counts_with_avx2(const GroupCounts *g)
{
    group_counts_any(g);
}
__attribute__((target("avx2"))) static void gather_with_avx2(const Gather *g) { gather_any(g); }
#endif

static void group_counts(const GroupCounts *g)
{
#ifdef X86_DISPATCH
    if (has_avx2) {
        group_counts_with_avx2(g);
        return;
    }
#endif
    group_counts_plain(g);
}

static void gather(const Gather *g)
{
#ifdef X86_DISPATCH
    if (has_avx2) {
        gather_with_avx2(g);
        return;
    }
#endif
    gather_plain(g);
}
