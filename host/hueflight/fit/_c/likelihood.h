/* SPDX-License-Identifier: Apache-2.0 */
/* Likelihoods of two delays of one pixel, and around a maximum where photons are few. */

/* A pixel's bins that hold counts, packed one after another. */
typedef struct {
    int count;
    int32_t *bins;
    float *counts, *flat, *means; /* counted; 1 ÷ expected of flat light; of parameters on trial */
} Lit;

/* `place` has room for four vectors a block. */
INLINE Lit lit_bins(const DelayTables *level, const float *counts, float total, float *place)
{
    size_t room = (size_t)level->blocks * LANES;
    Lit lit = {0, (int32_t *)place, place + room, place + 2 * room, place + 3 * room};
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
INLINE double log_likelihood(const DelayTables *level, const Lit *lit, float total, const vec *means)
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

/* Greatest log-likelihood at a candidate's delay with no amplitude below 0. */
INLINE double best_likelihood(const ModelTables *tables, const float *counts, float total,
                              const Candidate *candidate, vec *work)
{
    const DelayTables *level = &tables->fine;
    int phase = phase_of(level, candidate->delay);
    vec *means = work, *seen = work + level->blocks;
    float amplitudes[MOST_BANDS], least = LEAST_AMPLITUDE * total;
    float background = candidate->background, dark = floor_of(&tables->rules, total);
    background = background > dark ? background : dark;
    for (int k = 0; k < tables->bands; k++)
        amplitudes[k] = candidate->amplitudes[k] > least ? candidate->amplitudes[k] : least;
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
        for (int i = level->places[phase]; i < level->places[phase + 1]; i++) {
            Run run = level->runs[i];
            const float *shares = level->data + (size_t)run.place * LANES;
            for (int v = 0; v < run.count; v++) {
                gained[run.band] += seen[run.block + v] * load(shares + v * LANES);
                whole[run.band] += load(shares + v * LANES);
            }
        }
        background *= sum(dark_gained) / sum(dark_whole);
        for (int k = 0; k < tables->bands; k++) {
            float all = sum(whole[k]);
            amplitudes[k] *= sum(gained[k]) / (all > 1e-12f ? all : 1e-12f);
        }
    }
    expect(level, phase, amplitudes, background, means, NULL);
    Lit lit = lit_bins(level, counts, total, (float *)seen);
    return log_likelihood(level, &lit, total, means);
}

/* Mean and variance of the delay under the likelihood around its maximum. */
INLINE void posterior(const ModelTables *tables, const float *counts, float total,
                      const Candidate *candidate, vec *work, float *delay, float *variance)
{
    const DelayTables *level = &tables->fine;
    const FitRules *rules = &tables->rules;
    double logs[MOST_NODES], delays[MOST_NODES], most = -INFINITY;
    float stride = rintf(sqrtf(candidate->variance) * rules->node_spacing / level->phase_ns);
    stride = stride < 1 ? 1 : stride;
    float middle = rintf((candidate->delay - level->first_ns) / level->phase_ns);
    float least = floor_of(rules, total);
    Lit lit = lit_bins(level, counts, total, (float *)(work + level->blocks));
    for (int node = 0; node < rules->nodes; node++) {
        float place = middle + (float)(node - rules->nodes / 2) * stride;
        delays[node] = (double)level->first_ns + (double)place * (double)level->phase_ns;
        logs[node] = -INFINITY;
        if (place < 0 || place >= (float)level->phases)
            continue;
        float shift = (float)(delays[node] - (double)candidate->delay), amplitudes[MOST_BANDS];
        for (int k = 0; k < tables->bands; k++) {
            float a = candidate->amplitudes[k] + shift * candidate->follow[k];
            amplitudes[k] = a > 0 ? a : 0;
        }
        float background = candidate->background + shift * candidate->follow[tables->bands];
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
