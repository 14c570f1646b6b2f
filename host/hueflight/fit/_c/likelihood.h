/* SPDX-License-Identifier: Apache-2.0 */
/* Likelihoods of two delays of one pixel, and around a maximum where photons are few. */

/* A pixel's bins that hold counts, packed one after another. */
typedef struct {
    int count;
    int32_t *bins;
    float *counts, *flat, *means; /* counted; 1 ÷ expected of flat light; of parameters on trial */
} Seen;

/* `place` has room for four vectors a block. */
INLINE Seen seen_bins(const DelayTables *level, const float *counts, float total, float *place)
{
    size_t room = (size_t)level->blocks * LANES;
    Seen lit = {0, (int32_t *)place, place + room, place + 2 * room, place + 3 * room};
    lit.count = occupied(counts, level->bins, lit.bins, lit.counts);
    for (int i = 0; i < lit.count; i++)
        lit.flat[i] = 1 / (total * level->widths[lit.bins[i]] + LEAST);
    for (int i = lit.count; i % LANES; i++) {
        lit.counts[i] = 0;
        lit.means[i] = lit.flat[i] = 1;
    }
    return lit;
}

/* Log-likelihood of expected counts against that of flat light: differences of large numbers
 * would lose single precision's digits. */
INLINE double log_likelihood(const DelayTables *level, const Seen *lit, float total, const vec *means)
{
    vec excess = {0}, odd = {0}, gain = {0};
    int v = 0;
    for (; v + 2 <= level->blocks; v += 2) {
        excess += means[v] - total * load(level->widths + v * LANES);
        odd += means[v + 1] - total * load(level->widths + (v + 1) * LANES);
    }
    if (v < level->blocks)
        excess += means[v] - total * load(level->widths + v * LANES);
    excess += odd;
    for (int i = 0; i < lit->count; i++)
        lit->means[i] = ((const float *)means)[lit->bins[i]];
    for (int i = 0; i < lit->count; i += LANES)
        gain += load(lit->counts + i) * logarithm(load(lit->means + i) * load(lit->flat + i));
    return (double)sum(gain) - (double)sum(excess);
}

/* Greatest log-likelihood at a track's delay with no amplitude below 0. */
INLINE double best_likelihood(const ModelTables *tables, const float *counts, float total,
                              const float *track, vec *work)
{
    const DelayTables *level = &tables->fine;
    int phase = phase_of(level, track[AT_DELAY]);
    vec *means = work, *seen = work + level->blocks;
    float amplitudes[MOST_BANDS], least = LEAST_AMPLITUDE * total;
    float background = track[AT_BACKGROUND], dark = floor_of(&tables->rules, total);
    background = background > dark ? background : dark;
    for (int k = 0; k < tables->bands; k++)
        amplitudes[k] = track[AT_AMPLITUDES + k] > least ? track[AT_AMPLITUDES + k] : least;
    for (int round = 0; round < tables->rules.rounds; round++) {
        vec gained[MOST_BANDS], whole[MOST_BANDS], dark_gained = {0}, dark_whole = {0};
        memset(gained, 0, sizeof gained[0] * (size_t)tables->bands);
        memset(whole, 0, sizeof whole[0] * (size_t)tables->bands);
        expect(level, phase, amplitudes, background, means, NULL);
        for (int v = 0; v < level->blocks; v++) {
            vec width = load(level->widths + v * LANES);
            seen[v] = load(counts + v * LANES) / means[v];
            dark_gained += seen[v] * width;
            dark_whole += width;
        }
        for (int i = level->run_places[phase]; i < level->run_places[phase + 1]; i++) {
            Run run = level->runs[i];
            const float *shares = level->data + run.place;
            for (int v = 0; v < run.bins; v += LANES) {
                gained[run.band] += seen[(run.bin + v) / LANES] * load(shares + v);
                whole[run.band] += load(shares + v);
            }
        }
        background *= sum(dark_gained) / sum(dark_whole);
        for (int k = 0; k < tables->bands; k++) {
            float all = sum(whole[k]);
            amplitudes[k] *= sum(gained[k]) / (all > 1e-12f ? all : 1e-12f);
        }
    }
    expect(level, phase, amplitudes, background, means, NULL);
    Seen lit = seen_bins(level, counts, total, (float *)seen);
    return log_likelihood(level, &lit, total, means);
}

/* Mean and variance of the delay under the likelihood around its maximum. */
INLINE void posterior(const ModelTables *tables, const float *counts, float total,
                      const float *track, vec *work, float *delay, float *variance)
{
    const DelayTables *level = &tables->fine;
    const FitRules *rules = &tables->rules;
    const float *follow = track + follow_place(tables->bands);
    double logs[MOST_NODES], delays[MOST_NODES], most = -INFINITY;
    float stride = rintf(sqrtf(track[AT_VARIANCE]) * rules->node_spacing / level->phase_ns);
    stride = stride < 1 ? 1 : stride;
    float middle = rintf((track[AT_DELAY] - level->first_ns) / level->phase_ns);
    float least = floor_of(rules, total);
    Seen lit = seen_bins(level, counts, total, (float *)(work + level->blocks));
    for (int node = 0; node < rules->nodes; node++) {
        float place = middle + (float)(node - rules->nodes / 2) * stride;
        delays[node] = (double)level->first_ns + (double)place * (double)level->phase_ns;
        logs[node] = -INFINITY;
        if (place < 0 || place >= (float)level->phases)
            continue;
        float shift = (float)(delays[node] - (double)track[AT_DELAY]), amplitudes[MOST_BANDS];
        for (int k = 0; k < tables->bands; k++) {
            float a = track[AT_AMPLITUDES + k] + shift * follow[k];
            amplitudes[k] = a > 0 ? a : 0;
        }
        float background = track[AT_BACKGROUND] + shift * follow[tables->bands];
        background = background > least ? background : least;
        expect(level, (int)place, amplitudes, background, work, NULL);
        logs[node] = log_likelihood(level, &lit, total, work);
        most = logs[node] > most ? logs[node] : most;
    }
    double weight = 0, mean = 0, spread = 0;
    for (int node = 0; node < rules->nodes; node++) {
        logs[node] = exp(logs[node] - most);
        weight += logs[node];
        mean += logs[node] * delays[node];
    }
    mean /= weight;
    for (int node = 0; node < rules->nodes; node++)
        spread += logs[node] * (delays[node] - mean) * (delays[node] - mean);
    spread /= weight;
    if (spread == 0)
        spread = (double)stride * (double)level->phase_ns * (double)stride * (double)level->phase_ns / 12;
    *delay = (float)mean;
    *variance = (float)spread;
}
