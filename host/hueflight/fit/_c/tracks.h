/* SPDX-License-Identifier: Apache-2.0 */
/* Tracks: a delay that one pixel may have, with everything else that is fitted, on its way. Each is a
 * row of floats; rows of as many tracks as there are lanes are read and written side by side. */

/* Places in a row. After the amplitudes come as many variances of them, and then how amplitudes and
 * background change with the delay. */
enum { AT_DELAY, AT_BACKGROUND, AT_VARIANCE, AT_CUBIC, AT_TOTAL, AT_OFFSET, AT_AMPLITUDES };

INLINE int track_fields(int bands) { return AT_AMPLITUDES + 3 * bands + 1; }
INLINE int spread_place(int bands) { return AT_AMPLITUDES + bands; }
INLINE int follow_place(int bands) { return AT_AMPLITUDES + 2 * bands; }

/* Room for a row: whole blocks of lanes. */
INLINE size_t track_room(int bands)
{
    return ((size_t)track_fields(bands) + BLOCK_BINS - 1) / BLOCK_BINS * BLOCK_BINS;
}

/* The first fields of rows, each field a vector; `fields` has room for whole blocks. */
INLINE void read_fields(const float *const *rows, int count, vec *fields)
{
    int block = 0;
    do {
        for (int lane = 0; lane < LANES; lane++)
            fields[block + lane] = load(rows[lane] + block);
        transpose_floats(fields + block);
        block += LANES;
    } while (block < count);
}

/* The reverse for the first `some` rows; the fields are used up. */
INLINE void write_fields(vec *fields, int count, float *const *rows, int some)
{
    for (int block = 0; block < count; block += LANES) {
        transpose_floats(fields + block);
        for (int lane = 0; lane < some; lane++)
            store(rows[lane] + block, fields[block + lane]);
    }
}

/* Sorts numbers by the phase that each one has. `places` has room for phases + 1. */
INLINE void sort_by_phase(const int32_t *phase, int phases, const int32_t *from, int count,
                          int32_t *places, int32_t *sorted)
{
    memset(places, 0, ((size_t)phases + 1) * sizeof *places);
    for (int i = 0; i < count; i++)
        places[phase[from[i]] + 1]++;
    for (int p = 0; p < phases; p++)
        places[p + 1] += places[p];
    for (int i = 0; i < count; i++)
        sorted[places[phase[from[i]]]++] = from[i];
}

/* How many of sorted numbers, at most LANES, have the phase of the first. */
INLINE int same_phase(const int32_t *phase, const int32_t *sorted, int left)
{
    int some = 1;
    while (some < left && some < LANES && phase[sorted[some]] == phase[sorted[0]])
        some++;
    return some;
}
