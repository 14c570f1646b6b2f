/* Likelihoods: of two delays of one pixel, and around a maximum where photons are few. */

/* Means of a block's bins. */
INLINE vec mean_of(const Level *level, const int32_t *places, int block, const float *amplitudes,
                   float background)
{
    vec mean = background * load(level->widths + block * LANES);
    for (int i = places[block]; i < places[block + 1]; i++)
        mean += amplitudes[level->owners[i]] * load(level->data + (size_t)i * 2 * LANES);
    return greater(mean, fill(1e-20f));
}

/* Log-likelihood of given parameters against that of flat light: differences of large numbers
 * would lose single precision's digits. */
INLINE double log_likelihood(const Level *level, const float *counts, float total, int phase,
                             const float *amplitudes, float background)
{
    const int32_t *places = level->places + (size_t)phase * (size_t)(level->blocks + 1);
    double whole = 0;
    for (int block = 0; block < level->blocks; block++) {
        vec mean = mean_of(level, places, block, amplitudes, background);
        vec flat = greater(total * load(level->widths + block * LANES), fill(1e-20f));
        vec h = load(counts + block * LANES);
        whole += (double)sum(h * logarithm(mean / flat) - (mean - flat));
    }
    return whole;
}

/* Greatest log-likelihood at a track's delay with no amplitude below 0. */
INLINE double best_likelihood(const Plan *plan, const float *counts, float total,
                              const Track *track)
{
    const Level *level = &plan->fine;
    int phase = phase_of(level, track->delay);
    const int32_t *places = level->places + (size_t)phase * (size_t)(level->blocks + 1);
    float amplitudes[MOST_BANDS], least = 0.002f * total;
    float background = track->background, dark = floor_of(&plan->rules, total);
    background = background > dark ? background : dark;
    for (int k = 0; k < plan->bands; k++)
        amplitudes[k] = track->amplitudes[k] > least ? track->amplitudes[k] : least;
    for (int round = 0; round < plan->rules.rounds; round++) {
        vec gained[MOST_BANDS], whole[MOST_BANDS], dark_gained = {0}, dark_whole = {0};
        memset(gained, 0, sizeof gained[0] * (size_t)plan->bands);
        memset(whole, 0, sizeof whole[0] * (size_t)plan->bands);
        for (int block = 0; block < level->blocks; block++) {
            vec ratio = load(counts + block * LANES)
                      / mean_of(level, places, block, amplitudes, background);
            vec width = load(level->widths + block * LANES);
            dark_gained += ratio * width;
            dark_whole += width;
            for (int i = places[block]; i < places[block + 1]; i++) {
                vec shape = load(level->data + (size_t)i * 2 * LANES);
                gained[level->owners[i]] += ratio * shape;
                whole[level->owners[i]] += shape;
            }
        }
        background *= sum(dark_gained) / sum(dark_whole);
        for (int k = 0; k < plan->bands; k++) {
            float all = sum(whole[k]);
            amplitudes[k] *= sum(gained[k]) / (all > 1e-12f ? all : 1e-12f);
        }
    }
    return log_likelihood(level, counts, total, phase, amplitudes, background);
}

/* Mean and variance of the delay under the likelihood around its maximum. */
INLINE void posterior(const Plan *plan, const float *counts, float total, const Track *track,
                      float *delay, float *variance)
{
    enum { MOST_NODES = 32 };
    const Level *level = &plan->fine;
    const Rules *rules = &plan->rules;
    double logs[MOST_NODES], delays[MOST_NODES], most = -INFINITY;
    float stride = rintf(sqrtf(track->variance) * rules->spacing / level->phase_ns);
    stride = stride < 1 ? 1 : stride;
    float middle = rintf((track->delay - level->first_ns) / level->phase_ns);
    float least = floor_of(rules, total);
    for (int node = 0; node < rules->nodes; node++) {
        float place = middle + (float)(node - rules->nodes / 2) * stride;
        delays[node] = (double)level->first_ns + (double)place * (double)level->phase_ns;
        logs[node] = -INFINITY;
        if (place < 0 || place >= (float)level->phases)
            continue;
        float shift = (float)(delays[node] - (double)track->delay), amplitudes[MOST_BANDS];
        for (int k = 0; k < plan->bands; k++) {
            float a = track->amplitudes[k] + shift * track->follow[k];
            amplitudes[k] = a > 0 ? a : 0;
        }
        float background = track->background + shift * track->follow[plan->bands];
        background = background > least ? background : least;
        logs[node] = log_likelihood(level, counts, total, (int)place, amplitudes, background);
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
