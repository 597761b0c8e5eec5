/* Read an atlas of jaxstab with libhdf5, and answer from it.
 *
 *     cc -std=c99 -O2 program.c -lhdf5        (or h5cc; Debian: libhdf5-dev, -lhdf5_serial)
 *
 *     const char *problem;
 *     jaxstab_atlas *atlas = jaxstab_open("atlas.h5", &problem);
 *     int code = jaxstab_query(atlas, alpha, beta, gamma, delta, delay);
 *     jaxstab_close(atlas);
 *
 * Nodes hold both limits of the stable alpha over (gamma, delta, delay, row) and the ends of the
 * stable beta over (gamma, delta, delay); between nodes all is cubic along each axis, through the four
 * nearest nodes, but through none beyond a whole delay. Each cell has a measured error: a point that
 * is clear of the limits by four times that is answered by the table. Every other point is computed by jaxstab_verdict.h, wherever it is; for loops with an estimator or a filter,
 * which that does not know, the answer is JAXSTAB_UNDECIDED. A query allocates nothing.
 */
#ifndef JAXSTAB_ATLAS_H
#define JAXSTAB_ATLAS_H

#include "jaxstab_verdict.h"
#include <hdf5.h>
#include <math.h>
#include <stdlib.h>

typedef struct {
    double *axis[3], *alpha_limits, *beta_limits, *row;  /* gamma, delta, delay */
    float *alpha_error, *beta_error;
    signed char *beyond;
    size_t nodes[3], rows;
    int has_filters;
} jaxstab_atlas;

enum { JAXSTAB_MOST_BYTES = 1 << 30 };

/* Read a dataset of so many values, of any number if *count is 0; NULL if it is not as it should be. */
static inline void *jaxstab_read(hid_t file, const char *name, hid_t type, size_t *count)
{
    void *values = NULL;
    const hid_t dataset = H5Dopen2(file, name, H5P_DEFAULT);
    if (dataset < 0)
        return NULL;
    const hid_t space = H5Dget_space(dataset), plist = H5Dget_create_plist(dataset);
    const hid_t stored = H5Dget_type(dataset);
    const hssize_t size = H5Sget_simple_extent_npoints(space);
    const size_t bytes = H5Tget_size(type);
    const int is_plain = H5Pget_layout(plist) == H5D_CHUNKED && H5Pget_external_count(plist) == 0 &&
                         H5Pget_nfilters(plist) == 1;  /* Fletcher32 alone: no chunk expands */
    const int is_of_type = H5Tget_class(stored) == H5Tget_class(type) && H5Tget_size(stored) == bytes;
    if (is_plain && is_of_type && size > 0 && (size_t)size <= JAXSTAB_MOST_BYTES / bytes &&
        H5Dget_storage_size(dataset) >= (hsize_t)size * bytes && (*count == 0 || *count == (size_t)size)) {
        values = malloc((size_t)size * bytes);
        if (values && H5Dread(dataset, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) < 0) {
            free(values);
            values = NULL;
        }
        *count = (size_t)size;
    }
    H5Tclose(stored);
    H5Pclose(plist);
    H5Sclose(space);
    H5Dclose(dataset);
    return values;
}

static inline int jaxstab_number(hid_t file, const char *name)
{
    long long value = -1;
    const hid_t attribute = H5Aopen(file, name, H5P_DEFAULT);
    if (attribute >= 0) {
        const hid_t space = H5Aget_space(attribute);
        if (H5Sget_simple_extent_npoints(space) == 1 && H5Aread(attribute, H5T_NATIVE_LLONG, &value) < 0)
            value = -1;
        H5Sclose(space);
        H5Aclose(attribute);
    }
    return value < 0 || value > 1000 ? -1 : (int)value;
}

static inline void jaxstab_close(jaxstab_atlas *atlas)
{
    if (!atlas)
        return;
    for (int i = 0; i < 3; i++)
        free(atlas->axis[i]);
    free(atlas->row);
    free(atlas->alpha_limits);
    free(atlas->beta_limits);
    free(atlas->alpha_error);
    free(atlas->beta_error);
    free(atlas->beyond);
    free(atlas);
}

/* Whether all numbers are as the format says: nodes ascend, delays are at most 100, errors not negative. */
static inline int jaxstab_is_sound(const jaxstab_atlas *atlas)
{
    size_t cells = 2;
    for (int i = 0; i < 3; i++) {
        const double *nodes = atlas->axis[i];
        for (size_t k = 0; k < atlas->nodes[i]; k++)
            if (!isfinite(nodes[k]) || (i == 2 && fabs(nodes[k]) > 100.0) || (k > 0 && !(nodes[k] > nodes[k - 1])))
                return 0;
        cells *= atlas->nodes[i] > 1 ? atlas->nodes[i] - 1 : 1;
    }
    for (size_t k = 0; k < cells; k++)
        if (!(atlas->beta_error[k] >= 0.0f))
            return 0;
    for (size_t k = 0; k < cells * (atlas->rows - 1); k++)
        if (!(atlas->alpha_error[k] >= 0.0f))
            return 0;
    return 1;
}

static inline int jaxstab_load(hid_t file, jaxstab_atlas *atlas)
{
    static const char *const names[3] = {"gamma", "delta", "delay"};
    size_t plants = 1, cells = 1;
    for (int i = 0; i < 3; i++) {
        atlas->axis[i] = (double *)jaxstab_read(file, names[i], H5T_NATIVE_DOUBLE, &atlas->nodes[i]);
        if (!atlas->axis[i] || plants > JAXSTAB_MOST_BYTES / atlas->nodes[i])
            return 0;
        plants *= atlas->nodes[i];
        cells *= atlas->nodes[i] > 1 ? atlas->nodes[i] - 1 : 1;
    }
    atlas->row = (double *)jaxstab_read(file, "row", H5T_NATIVE_DOUBLE, &atlas->rows);
    if (!atlas->row || atlas->rows < 2 || plants > JAXSTAB_MOST_BYTES / atlas->rows)
        return 0;
    size_t ends = 2 * plants, limits = ends * atlas->rows, end_cells = 2 * cells;
    size_t limit_cells = end_cells * (atlas->rows - 1);
    atlas->alpha_limits = (double *)jaxstab_read(file, "alpha_limits", H5T_NATIVE_DOUBLE, &limits);
    atlas->beta_limits = (double *)jaxstab_read(file, "beta_limits", H5T_NATIVE_DOUBLE, &ends);
    atlas->alpha_error = (float *)jaxstab_read(file, "alpha_error", H5T_NATIVE_FLOAT, &limit_cells);
    atlas->beta_error = (float *)jaxstab_read(file, "beta_error", H5T_NATIVE_FLOAT, &end_cells);
    atlas->beyond = (signed char *)jaxstab_read(file, "beyond", H5T_NATIVE_SCHAR, &cells);
    return atlas->alpha_limits && atlas->beta_limits && atlas->alpha_error && atlas->beta_error &&
           atlas->beyond && jaxstab_is_sound(atlas);
}

/* Return an atlas, or NULL and a problem in words. */
static inline jaxstab_atlas *jaxstab_open(const char *path, const char **problem)
{
    jaxstab_atlas *atlas = (jaxstab_atlas *)calloc(1, sizeof *atlas);
    H5Eset_auto2(H5E_DEFAULT, NULL, NULL);
    const hid_t file = H5Fopen(path, H5F_ACC_RDONLY, H5P_DEFAULT);
    *problem = file < 0 ? "cannot be opened as HDF5"
                        : "is damaged, no atlas of version 5, or too large for the memory here";
    int is_sound = atlas && file >= 0 && jaxstab_number(file, "schema_version") == 5;
    if (is_sound) {
        atlas->has_filters = jaxstab_number(file, "has_filters");
        is_sound = atlas->has_filters >= 0 && jaxstab_load(file, atlas);
    }
    if (file >= 0)
        H5Fclose(file);
    if (!is_sound) {
        jaxstab_close(atlas);
        return NULL;
    }
    return atlas;
}

/* The neighbouring nodes of an axis that count at a value in a cell, from a first one on, and their weights. */
typedef struct {
    size_t first;
    int count;
    double weight[4];
} jaxstab_near;

/* Limits bend at whole delays, which no cubic crosses. */
static inline int jaxstab_bends(const double *delays, size_t node)
{
    return delays && delays[node] == (double)(int)delays[node];
}

/* Without an array the nodes are at 0, 1, 2 ...; delays are given where the axis is that of delays. */
static inline jaxstab_near jaxstab_weights(const double *nodes, const double *delays, size_t last,
                                           size_t cell, double value)
{
    jaxstab_near near;
    size_t low = cell, high = last ? cell + 1 : cell;
    double place[4];
    if (low > 0 && !jaxstab_bends(delays, low))
        low--;
    while (high < last && high - low < 3 && !jaxstab_bends(delays, high))
        high++;
    while (low > 0 && high - low < 3 && !jaxstab_bends(delays, low))
        low--;
    near.first = low;
    near.count = (int)(high - low) + 1;
    for (int j = 0; j < near.count; j++)
        place[j] = nodes ? nodes[low + (size_t)j] : (double)low + j;
    for (int j = 0; j < near.count; j++) {
        double above = 1.0, below = 1.0;
        for (int k = 0; k < near.count; k++)
            if (k != j) {
                above *= value - place[k];
                below *= place[j] - place[k];
            }
        near.weight[j] = above / below;
    }
    return near;
}

/* Where a plant is: its nodes with their weights, and its cell. */
typedef struct {
    size_t node[64], cell;
    double weight[64], ends[2];
    int count;
} jaxstab_place;

static inline int jaxstab_find(const jaxstab_atlas *atlas, const double plant[3], jaxstab_place *at)
{
    jaxstab_near near[3];
    at->cell = 0;
    for (int i = 0; i < 3; i++) {
        const double *nodes = atlas->axis[i], value = plant[i];
        const size_t last = atlas->nodes[i] - 1;
        size_t low = 0, high = last;
        if (!(value >= nodes[0] && value <= nodes[last]))
            return 0;
        while (high > low + 1) {
            const size_t middle = (low + high) / 2;
            *(nodes[middle] <= value ? &low : &high) = middle;
        }
        at->cell = at->cell * (last ? last : 1) + low;
        near[i] = jaxstab_weights(nodes, i == 2 ? nodes : NULL, last, low, value);
    }
    at->count = 0;
    at->ends[0] = at->ends[1] = 0.0;
    for (int i = 0; i < near[0].count; i++)
        for (int j = 0; j < near[1].count; j++)
            for (int k = 0; k < near[2].count; k++) {
                const size_t row = (near[0].first + (size_t)i) * atlas->nodes[1] + near[1].first + (size_t)j;
                const size_t node = row * atlas->nodes[2] + near[2].first + (size_t)k;
                const double weight = near[0].weight[i] * near[1].weight[j] * near[2].weight[k];
                at->node[at->count] = node;
                at->weight[at->count++] = weight;
                at->ends[0] += weight * atlas->beta_limits[2 * node];
                at->ends[1] += weight * atlas->beta_limits[2 * node + 1];
            }
    return 1;
}

/* Both limits of the stable alpha at a beta, and the number of the cell; 0 beyond the ends of beta. */
static inline int jaxstab_limits_in(const jaxstab_atlas *atlas, const jaxstab_place *at, double beta,
                                    double limits[2], size_t *cell)
{
    const size_t count = atlas->rows - 1;
    const double u = (beta - at->ends[0]) / (at->ends[1] - at->ends[0]) * (double)count;
    if (!(u >= 0.0 && u <= (double)count))
        return 0;
    const size_t row = (size_t)u < count ? (size_t)u : count - 1;
    const jaxstab_near near = jaxstab_weights(NULL, NULL, count, row, u);
    double rows[8] = {0.0};
    for (int c = 0; c < at->count; c++) {
        const double *own = atlas->alpha_limits + 2 * (at->node[c] * atlas->rows + near.first);
        for (int j = 0; j < 2 * near.count; j++)
            rows[j] += at->weight[c] * own[j];
    }
    limits[0] = limits[1] = 0.0;
    for (int j = 0; j < near.count; j++) {
        limits[0] += near.weight[j] * rows[2 * j];
        limits[1] += near.weight[j] * rows[2 * j + 1];
    }
    *cell = at->cell * count + row;
    return 1;
}

/* The interpolated limits of the stable alpha, and their measured errors; 0 where nothing is known. */
static inline int jaxstab_alpha_limits(const jaxstab_atlas *atlas, double beta, double gamma,
                                       double delta, double delay, double limits[2], double errors[2])
{
    const double plant[3] = {gamma, delta, delay};
    jaxstab_place at;
    size_t cell;
    if (!jaxstab_find(atlas, plant, &at) || !jaxstab_limits_in(atlas, &at, beta, limits, &cell))
        return 0;
    errors[0] = atlas->alpha_error[2 * cell];
    errors[1] = atlas->alpha_error[2 * cell + 1];
    return limits[0] == limits[0] && limits[1] == limits[1];
}

/* The verdict of the table, or JAXSTAB_UNDECIDED where it is not clear. */
static inline int jaxstab_table_verdict(const jaxstab_atlas *atlas, double alpha, double beta,
                                        double gamma, double delta, double delay)
{
    const double plant[3] = {gamma, delta, delay}, clear = 4.0, rounding = 5.7e-14;
    jaxstab_place at;
    double limits[2];
    size_t cell;
    if (!jaxstab_find(atlas, plant, &at))
        return JAXSTAB_UNDECIDED;
    const double size = rounding * (fabs(at.ends[0]) + fabs(at.ends[1]));
    const double low = clear * atlas->beta_error[2 * at.cell] + size;
    const double high = clear * atlas->beta_error[2 * at.cell + 1] + size;
    if (beta < at.ends[0] - low || beta > at.ends[1] + high)
        return atlas->beyond[at.cell] == 1 ? JAXSTAB_UNSTABLE : JAXSTAB_UNDECIDED;
    if (!(beta > at.ends[0] + low && beta < at.ends[1] - high) ||
        !jaxstab_limits_in(atlas, &at, beta, limits, &cell))
        return JAXSTAB_UNDECIDED;
    const double rest = rounding * (fabs(limits[0]) + fabs(limits[1]) + fabs(alpha));
    const double lower = clear * atlas->alpha_error[2 * cell] + rest;
    const double upper = clear * atlas->alpha_error[2 * cell + 1] + rest;
    if (!isfinite(lower + upper))
        return JAXSTAB_UNDECIDED;
    if (alpha > limits[0] + lower && alpha < limits[1] - upper)
        return JAXSTAB_STABLE;
    return alpha < limits[0] - lower || alpha > limits[1] + upper ? JAXSTAB_UNSTABLE : JAXSTAB_UNDECIDED;
}

/* The verdict on a point, by the table or computed. */
static inline int jaxstab_query(const jaxstab_atlas *atlas, double alpha, double beta, double gamma,
                                double delta, double delay)
{
    const int code = jaxstab_table_verdict(atlas, alpha, beta, gamma, delta, delay);
    return code != JAXSTAB_UNDECIDED || atlas->has_filters
               ? code : jaxstab_verdict(alpha, beta, gamma, delta, delay);
}

#endif
