/* A libFuzzer harness for the reader in C: what a stranger's file may hold.
 *
 *     clang -std=c99 -g -O1 -fsanitize=fuzzer,address,undefined fuzz_reader.c -I READER -lhdf5 -o fuzz_reader
 *     fuzz_reader CORPUS
 *
 * libhdf5 is what it is: its own faults are not looked for. An input is not a file but what libhdf5
 * would hand over, so that the fuzzer is at the reader's checks and look-ups with every input: first
 * the lengths of the axes and of the rows, then all numbers in order, as bytes. */
#include <stdint.h>
#include <string.h>

#include "jaxstab_atlas.h"

static const uint8_t *rest;
static size_t left;

/* Return so many values of a size from the input, zeros where it has ended; NULL beyond a bound. */
static void *taken(size_t count, size_t size)
{
    if (count > 4096)
        return NULL;
    unsigned char *values = (unsigned char *)calloc(count ? count : 1, size);
    const size_t bytes = count * size < left ? count * size : left;
    if (values)
        memcpy(values, rest, bytes);
    rest += bytes;
    left -= bytes;
    return values;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    size_t plants = 1, cells = 1;
    if (size < 4)
        return 0;
    jaxstab_atlas *atlas = (jaxstab_atlas *)calloc(1, sizeof *atlas);
    if (!atlas)
        return 0;
    rest = data + 4;
    left = size - 4;
    for (int i = 0; i < 3; i++) {
        atlas->nodes[i] = 1 + data[i] % 4;
        atlas->axis[i] = (double *)taken(atlas->nodes[i], sizeof(double));
        plants *= atlas->nodes[i];
        cells *= atlas->nodes[i] > 1 ? atlas->nodes[i] - 1 : 1;
    }
    atlas->rows = 2 + data[3] % 4;
    atlas->row = (double *)taken(atlas->rows, sizeof(double));
    atlas->alpha_limits = (double *)taken(2 * plants * atlas->rows, sizeof(double));
    atlas->beta_limits = (double *)taken(2 * plants, sizeof(double));
    atlas->alpha_error = (float *)taken(2 * cells * (atlas->rows - 1), sizeof(float));
    atlas->beta_error = (float *)taken(2 * cells, sizeof(float));
    atlas->beyond = (signed char *)taken(cells, 1);
    if (jaxstab_is_sound(atlas)) {
        for (int i = 0; i < 64; i++) {
            double p[5];
            for (int k = 0; k < 3; k++)
                p[2 + k] = atlas->axis[k][(i >> (2 * k)) % 4 % (int)atlas->nodes[k]];
            p[1] = i % 3 ? atlas->beta_limits[i % 2] : 0.25;
            p[0] = i % 5 ? atlas->alpha_limits[i % 4] : NAN;
            const int code = jaxstab_query(atlas, p[0], p[1], p[2], p[3], p[4]);
            double limits[2], errors[2];
            if (code < 1 || code > 3)
                __builtin_trap();
            if (jaxstab_alpha_limits(atlas, p[1], p[2], p[3], p[4], limits, errors) &&
                !(errors[0] >= 0.0f && errors[1] >= 0.0f))
                __builtin_trap();
        }
    }
    jaxstab_close(atlas);
    return 0;
}
