/* A libFuzzer harness for the reader in C: what a stranger's file may hold.
 *
 *     clang -std=c99 -g -O1 -fsanitize=fuzzer,address,undefined fuzz_reader.c -I READER -o fuzz_reader
 *     fuzz_reader -dict=fuzz_reader.dict CORPUS
 *
 * An input is the HDF5 image, an empty line, and the table: footer and content digest are made right
 * here, and digests of chunks count as right, for no fuzzer finds a SHA-256. */
#define jaxstab_has_digest_ jaxstab_has_real_digest_
#include "jaxstab_footer.h"
#undef jaxstab_has_digest_

/* Whether 64 hexadecimal digits follow; all bytes are looked at, as for a digest. */
static inline int jaxstab_has_digest_(const unsigned char *bytes, size_t length, const char *digits)
{
    static volatile unsigned char sum;
    for (size_t i = 0; i < length; i++)
        sum = (unsigned char)(sum + bytes[i]);
    for (int i = 0; i < 64; i++) /* which ends at the end of a text that is too short */
        if (!((digits[i] >= '0' && digits[i] <= '9') || (digits[i] >= 'a' && digits[i] <= 'f')))
            return 0;
    return 1;
}

#include "jaxstab_atlas.h"

/* Ask about a point and its neighbours; what is answered must be an answer. */
static void ask(const jaxstab_atlas *atlas, const double *p)
{
    jaxstab_limits at;
    const int code = jaxstab_verdict(atlas, p[0], p[1], p[2], p[3], p[4]);
    const int is_inside = jaxstab_alpha_limits(atlas, p[1], p[2], p[3], p[4], &at);
    const int is_known = is_inside && code >= 1 && code <= 3;
    if ((!is_known && code != JAXSTAB_OUTSIDE && code != JAXSTAB_UNSTABLE) ||
        !(at.lower_error >= 0.0) || !(at.upper_error >= 0.0))
        __builtin_trap();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    size_t image = 0, end;
    if (jaxstab_is_whole_(data, size, &image, &end) && image > end)
        __builtin_trap();
    for (image = 0; image + 1 < size && !(data[image] == '\n' && data[image + 1] == '\n');)
        image++;
    if (image + 2 > size)
        return 0;
    const size_t length = size - image - 2;
    char *text = (char *)malloc(length + 1);
    if (!text)
        return 0;
    memcpy(text, data + image + 2, length);
    text[length] = 0;
    const char *problem = NULL;
    jaxstab_atlas *atlas = jaxstab_loaded_(data, image, text, length, &problem);
    if (!atlas && !problem)
        __builtin_trap();
    if (atlas) {
        for (size_t k = 0; k < atlas->delay_cells; k++) {
            const jaxstab_walls_ *w = &atlas->walls[k];
            for (int i = 0; i < 64; i++) {
                const double share = i % 4 / 3.0;
                const double p[5] = {
                    w->lowest_alpha + share * (w->highest_alpha - w->lowest_alpha),
                    i & 4 ? w->highest_beta : w->lowest_beta,
                    atlas->gamma[i & 8 ? atlas->gammas - 1 : 0],
                    atlas->delta[i & 16 ? atlas->deltas - 1 : 0],
                    i & 32 ? w->highest_delay : w->lowest_delay};
                ask(atlas, p);
            }
            const double odd[][5] = {{NAN, NAN, NAN, NAN, NAN},
                                     {0.1, w->highest_beta, 0.0, 0.0, INFINITY},
                                     {-INFINITY, w->lowest_beta, 1e300, -1.0, w->lowest_delay}};
            for (int i = 0; i < 3; i++)
                ask(atlas, odd[i]);
        }
    }
    jaxstab_close(atlas);
    free(text);
    return 0;
}
