/* SPDX-License-Identifier: Apache-2.0 */
/* Where the surfaces about each pixel are looked for; the definition is `inner_starts`
 * of hueflight/reconstruction/edges.py. */

/* Planes of an image, with room for a vector behind the last pixel. */
typedef struct {
    int rows, cols;
    float *depth; /* infinite where it is not known, */
    float *reach, *weight, *moment; /* and these 0 */
} Planes;

/* The third smallest of a window's neighbors, or the last of fewer; `sign` is 1, or −1 for the third
 * largest. */
INLINE vec third_extreme(const Planes *planes, const float *corner, float sign)
{
    vec infinite = fill(INFINITY), first = infinite, second = infinite, third = infinite;
    for (int place = 0; place < WINDOW * WINDOW; place++) {
        if (place == WINDOW * WINDOW / 2)
            continue;
        vec x = load(corner + place / WINDOW * planes->cols + place % WINDOW);
        x = choose(x < infinite, sign * x, infinite);
        third = lesser(third, greater(second, x));
        second = lesser(second, greater(first, x));
        first = lesser(first, x);
    }
    vec last = choose(second < infinite, second, first);
    return sign * choose(third < infinite, third, last);
}

/* Mean of the neighbors within reach of a start, else the start. */
INLINE vec mean_about(const Planes *planes, ptrdiff_t corner, vec start)
{
    vec total = {0}, moment = {0};
    for (int place = 0; place < WINDOW * WINDOW; place++) {
        if (place == WINDOW * WINDOW / 2)
            continue;
        ptrdiff_t at = corner + place / WINDOW * planes->cols + place % WINDOW;
        vec off = load(planes->depth + at) - start;
        ivec inside = greater(off, -off) < load(planes->reach + at);
        total += choose(inside, load(planes->weight + at), (vec){0});
        moment += choose(inside, load(planes->moment + at), (vec){0});
    }
    return choose(total > 0, moment / choose(total > 0, total, fill(1)), start);
}

/* One row of the pixels that have a whole window. */
APART void surface_starts(const Planes *planes, int row, float *near, float *far)
{
    int cols = planes->cols - WINDOW + 1;
    for (int col = 0; col < cols; col += LANES) {
        ptrdiff_t corner = (ptrdiff_t)row * planes->cols + col;
        size_t bytes = sizeof(float) * (size_t)(cols - col < LANES ? cols - col : LANES);
        for (int side = 0; side < 2; side++) {
            vec start = third_extreme(planes, planes->depth + corner, side ? -1 : 1);
            vec found = mean_about(planes, corner, start);
            memcpy((side ? far : near) + col, &found, bytes);
        }
    }
}

/* Fills the planes with depths, NaN where not known, and their standard deviations. */
INLINE void fill_planes(Planes *planes, const float *depth, const float *deviation, float reach)
{
    ptrdiff_t pixels = (ptrdiff_t)planes->rows * planes->cols;
    for (ptrdiff_t i = 0; i < pixels + LANES; i++) {
        int known = i < pixels && depth[i] == depth[i];
        float weight = known ? 1 / (deviation[i] * deviation[i]) : 0;
        planes->depth[i] = known ? depth[i] : INFINITY;
        planes->reach[i] = known ? reach * deviation[i] : 0;
        planes->weight[i] = weight;
        planes->moment[i] = known ? weight * depth[i] : 0;
    }
}
