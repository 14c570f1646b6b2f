/* Fisher scoring of sixteen tracks at once: sums over bins one track at a time, sixteen bins a
 * vector; then the normal equations of all sixteen, one track a lane. */

typedef struct {
    vec normal[MOST_SIZE * (MOST_SIZE + 1) / 2]; /* lower triangle, rows one after another */
    vec right[MOST_SIZE];
    vec cubic;
} Equations;

#define AT(row, col) ((row) * ((row) + 1) / 2 + (col))

INLINE int phase_of(const Level *level, float delay)
{
    int phase = (int)rintf((delay - level->first_ns) / level->phase_ns);
    return phase < 0 ? 0 : phase >= level->phases ? level->phases - 1 : phase;
}

INLINE float floor_of(const Rules *rules, float total)
{
    return rules->floor_photons + rules->floor_share * total;
}

/* Sums of one track over all bins, into its lane of the equations. */
INLINE void accumulate(const Level *level, const Rules *rules, const float *counts, float total,
                       const Track *track, int bands, int phase, Equations *into, int lane)
{
    vec own[MOST_BANDS][4], pairs[MOST_BANDS * (MOST_BANDS - 1) / 2 + 1];
    uint8_t met[MOST_BANDS * (MOST_BANDS - 1) / 2 + 1];
    float amplitudes[MOST_BANDS];
    int pair_count = bands * (bands - 1) / 2;
    memset(met, 0, (size_t)pair_count + 1);
    memset(own, 0, sizeof own[0] * (size_t)bands);
    for (int k = 0; k < bands; k++)
        amplitudes[k] = track->amplitudes[k] > 0 ? track->amplitudes[k] : 0;
    float least = floor_of(rules, total);
    float background = track->background > least ? track->background : least;
    vec tt = {0}, tb = {0}, bb = {0}, rt = {0}, rb = {0}, cubic = {0};
    const int32_t *places = level->places + (size_t)phase * (size_t)(level->blocks + 1);
    for (int block = 0; block < level->blocks; block++) {
        int first = places[block], last = places[block + 1];
        const float *data = level->data + (size_t)first * 2 * LANES;
        vec h = load(counts + block * LANES), width = load(level->widths + block * LANES);
        vec mean = background * width, slope = {0};
        for (int i = first; i < last; i++, data += 2 * LANES) {
            float a = amplitudes[level->owners[i]];
            mean += a * load(data);
            slope += a * load(data + LANES);
        }
        vec weight = 1.0f / greater(mean, fill(1e-20f));
        vec along = weight * slope, share = weight * width;
        tt += along * slope;
        tb += along * width;
        bb += share * width;
        rt += along * h;
        rb += share * h;
        cubic += along * along * slope;
        data = level->data + (size_t)first * 2 * LANES;
        for (int i = first; i < last; i++) {
            int band = level->owners[i];
            vec shape = load(data + (size_t)(i - first) * 2 * LANES), part = weight * shape;
            own[band][0] += part * shape;
            own[band][1] += part * width;
            own[band][2] += part * slope;
            own[band][3] += part * h;
            for (int j = first; j < i; j++) { /* bands of a block rise */
                int pair = band * (band - 1) / 2 + level->owners[j];
                vec other = part * load(data + (size_t)(j - first) * 2 * LANES);
                if (met[pair])
                    pairs[pair] += other;
                else
                    pairs[pair] = other;
                met[pair] = 1;
            }
        }
    }
    int b = bands, t = bands + 1;
    for (int k = 0; k < bands; k++) {
        into->normal[AT(k, k)][lane] = sum(own[k][0]);
        into->normal[AT(b, k)][lane] = sum(own[k][1]);
        into->normal[AT(t, k)][lane] = sum(own[k][2]);
        into->right[k][lane] = sum(own[k][3]);
        for (int j = 0; j < k; j++) {
            int pair = k * (k - 1) / 2 + j;
            into->normal[AT(k, j)][lane] = met[pair] ? sum(pairs[pair]) : 0.0f;
        }
    }
    into->normal[AT(b, b)][lane] = sum(bb);
    into->normal[AT(t, b)][lane] = sum(tb);
    into->normal[AT(t, t)][lane] = sum(tt);
    into->right[b][lane] = sum(rb);
    into->right[t][lane] = sum(rt);
    into->cubic[lane] = sum(cubic);
}

/* Solve sixteen systems by Cholesky's method. The inverse's lower factor replaces the normal
 * matrix and the solution the right side, both in the parameters' own scale. */
INLINE void solve(Equations *e, int size, float ridge)
{
    vec scale[MOST_SIZE], inverse[MOST_SIZE];
    for (int i = 0; i < size; i++)
        scale[i] = 1.0f / root(e->normal[AT(i, i)]);
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++)
            e->normal[AT(i, j)] *= scale[i] * scale[j];
    for (int j = 0; j < size; j++) {
        vec diagonal = e->normal[AT(j, j)] + ridge;
        for (int k = 0; k < j; k++)
            diagonal -= e->normal[AT(j, k)] * e->normal[AT(j, k)];
        inverse[j] = 1.0f / root(greater(diagonal, fill(0.5f * ridge)));
        for (int i = j + 1; i < size; i++) {
            vec x = e->normal[AT(i, j)];
            for (int k = 0; k < j; k++)
                x -= e->normal[AT(i, k)] * e->normal[AT(j, k)];
            e->normal[AT(i, j)] = x * inverse[j];
        }
    }
    for (int j = 0; j < size; j++) { /* the factor's inverse, column by column from the left */
        vec column[MOST_SIZE];
        column[j] = inverse[j];
        for (int i = j + 1; i < size; i++) {
            vec x = {0};
            for (int k = j; k < i; k++)
                x -= e->normal[AT(i, k)] * column[k];
            column[i] = x * inverse[i];
        }
        for (int i = j; i < size; i++) /* entries right of column j are still the factor's */
            e->normal[AT(i, j)] = column[i];
    }
    vec half[MOST_SIZE];
    for (int i = 0; i < size; i++) {
        half[i] = (vec){0};
        for (int k = 0; k <= i; k++)
            half[i] += e->normal[AT(i, k)] * scale[k] * e->right[k];
    }
    for (int i = 0; i < size; i++) {
        vec x = {0};
        for (int k = i; k < size; k++)
            x += e->normal[AT(k, i)] * half[k];
        e->right[i] = x * scale[i];
    }
    for (int i = 0; i < size; i++)
        for (int j = 0; j <= i; j++)
            e->normal[AT(i, j)] *= scale[j];
}

/* One step of scoring for up to sixteen tracks. `moved` gets each one's change of delay. */
INLINE void step(const Plan *plan, const Level *level, const float *counts, size_t stride,
                 const float *totals, const float *offsets, Track *const *tracks, int count,
                 Equations *e, float *moved)
{
    const Rules *rules = &plan->rules;
    int bands = plan->bands, size = bands + 2, t = bands + 1;
    float range = rules->high_ns - rules->low_ns, widest = 12 / (range * range);
    float here[LANES];
    for (int lane = 0; lane < LANES; lane++) { /* lanes to spare repeat the first track */
        const Track *track = tracks[lane < count ? lane : 0];
        if (lane >= count) {
            for (int i = 0; i < AT(size, 0); i++)
                e->normal[i][lane] = e->normal[i][0];
            for (int i = 0; i < size; i++)
                e->right[i][lane] = e->right[i][0];
            continue;
        }
        int phase = phase_of(level, track->delay);
        here[lane] = level->first_ns + (float)phase * level->phase_ns;
        accumulate(level, rules, counts + (size_t)track->pixel * stride, totals[track->pixel],
                   track, bands, phase, e, lane);
        float most = 2 * totals[track->pixel] + 10, known = 1 / (most * most);
        for (int k = 0; k <= bands; k++)
            e->normal[AT(k, k)][lane] += known;
        e->normal[AT(t, t)][lane] += widest;
    }
    solve(e, size, rules->ridge);
    for (int lane = 0; lane < count; lane++) {
        Track *track = tracks[lane];
        float move = e->right[t][lane], limit = rules->spread_ns;
        move = move > limit ? limit : move < -limit ? -limit : move;
        float offset = offsets[track->pixel];
        float low = offset + rules->low_ns, high = offset + rules->high_ns;
        float delay = here[lane] + move;
        delay = delay < low ? low : delay > high ? high : delay;
        moved[lane] = fabsf(delay - track->delay);
        track->delay = delay;
        track->background = e->right[bands][lane];
        track->cubic = e->cubic[lane];
        float tip = e->normal[AT(t, t)][lane];
        track->variance = tip * tip;
        for (int k = 0; k <= bands; k++) /* change of a parameter that follows the delay's */
            track->follow[k] = e->normal[AT(t, k)][lane] / tip;
        for (int k = 0; k < bands; k++) {
            track->amplitudes[k] = e->right[k][lane];
            float variance = 0;
            for (int i = k; i < size; i++)
                variance += e->normal[AT(i, k)][lane] * e->normal[AT(i, k)][lane];
            track->spread[k] = variance;
        }
    }
}
