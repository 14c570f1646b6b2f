/* SPDX-License-Identifier: Apache-2.0 */
/* Whether a pixel shows a surface at all: likelihood ratio of the fit against background alone. See
 * detection.py, which is the definition. */

/* Twice the log-likelihood ratio of a candidate, at the bins of the search. */
INLINE float likelihood_ratio(const ModelTables *tables, const float *counts, float total, float delay,
                              const Candidate *candidate, vec *work)
{
    const DelayTables *level = &tables->wide;
    float amplitudes[MOST_BANDS], least = tables->rules.detection_share * total;
    for (int k = 0; k < tables->bands; k++)
        amplitudes[k] = candidate->amplitudes[k] > 0 ? candidate->amplitudes[k] : 0;
    float background = candidate->background > least ? candidate->background : least;
    expect(level, phase_of(level, delay), amplitudes, background, work, NULL);
    vec whole = {0}, gain = {0};
    for (int v = 0; v < level->blocks; v++)
        whole += work[v];
    float scale = 1 / sum(whole);
    for (int v = 0; v < level->blocks; v++) {
        vec h = load(counts + v * LANES), width = load(level->widths + v * LANES) + LEAST;
        gain += choose(h > 0.0f, h * logarithm(work[v] * scale / width + LEAST), (vec){0});
    }
    return 2 * sum(gain);
}
