/* Is a file of jaxstab whole? Part of jaxstab_atlas.h, standard C99 alone.
 *
 * Its last 48 bytes are "jaxstab\n", the length of the HDF5 image at its beginning (8 bytes, the
 * least first), and the SHA-256 (FIPS 180-4) of all that is before them.
 */
#ifndef JAXSTAB_FOOTER_H
#define JAXSTAB_FOOTER_H

#include <limits.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__unix__) || defined(__APPLE__)
#include <sys/stat.h>
#define JAXSTAB_HAS_STAT_
#endif

static inline uint32_t jaxstab_rotated_(uint32_t word, int right)
{
    return word >> right | word << (32 - right);
}

static inline void jaxstab_sha256_block_(uint32_t state[8], const unsigned char block[64])
{
    static const uint32_t k[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4,
        0xab1c5ed5, 0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe,
        0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f,
        0x4a7484aa, 0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7,
        0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85, 0x2e1b2138, 0x4d2c6dfc,
        0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b,
        0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116,
        0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7,
        0xc67178f2};
    uint32_t w[64], s[8];
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)block[4 * i] << 24 | (uint32_t)block[4 * i + 1] << 16 |
               (uint32_t)block[4 * i + 2] << 8 | block[4 * i + 3];
    for (int i = 16; i < 64; i++)
        w[i] = w[i - 16] + w[i - 7] +
               (jaxstab_rotated_(w[i - 15], 7) ^ jaxstab_rotated_(w[i - 15], 18) ^ w[i - 15] >> 3) +
               (jaxstab_rotated_(w[i - 2], 17) ^ jaxstab_rotated_(w[i - 2], 19) ^ w[i - 2] >> 10);
    memcpy(s, state, sizeof s);
    for (int i = 0; i < 64; i++) {
        const uint32_t a = s[0], e = s[4];
        const uint32_t first =
            s[7] + k[i] + w[i] + ((e & s[5]) ^ (~e & s[6])) +
            (jaxstab_rotated_(e, 6) ^ jaxstab_rotated_(e, 11) ^ jaxstab_rotated_(e, 25));
        const uint32_t second =
            ((a & s[1]) ^ (a & s[2]) ^ (s[1] & s[2])) +
            (jaxstab_rotated_(a, 2) ^ jaxstab_rotated_(a, 13) ^ jaxstab_rotated_(a, 22));
        memmove(s + 1, s, 7 * sizeof *s);
        s[4] += first;
        s[0] = first + second;
    }
    for (int i = 0; i < 8; i++)
        state[i] += s[i];
}

static inline void jaxstab_sha256_(const unsigned char *bytes, size_t length,
                                   unsigned char digest[32])
{
    uint32_t state[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                         0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    unsigned char tail[128] = {0};
    const size_t rest = length % 64, padded = rest < 56 ? 64 : 128;
    for (size_t at = 0; at + 64 <= length; at += 64)
        jaxstab_sha256_block_(state, bytes + at);
    memcpy(tail, bytes + (length - rest), rest);
    tail[rest] = 0x80;
    for (int i = 0; i < 8; i++)
        tail[padded - 1 - (size_t)i] = (unsigned char)((uint64_t)length * 8 >> 8 * i);
    for (size_t at = 0; at < padded; at += 64)
        jaxstab_sha256_block_(state, tail + at);
    for (int i = 0; i < 32; i++)
        digest[i] = (unsigned char)(state[i / 4] >> (24 - 8 * (i % 4)));
}

/* Whether bytes have a digest, given in hexadecimal. */
static inline int jaxstab_has_digest_(const unsigned char *bytes, size_t length, const char *digits)
{
    unsigned char digest[32];
    jaxstab_sha256_(bytes, length, digest);
    for (int i = 0; i < 64; i++) /* which ends at the end of a text that is too short */
        if (digits[i] != "0123456789abcdef"[digest[i / 2] >> (i % 2 ? 0 : 4) & 15])
            return 0;
    return 1;
}

/* Whether the footer of a file is right; if so, where the image and the table after it end. */
static inline int jaxstab_is_whole_(const unsigned char *bytes, size_t length, size_t *image,
                                    size_t *table)
{
    unsigned char digest[32];
    uint64_t size = 0;
    if (length < 48 || memcmp(bytes + (length - 48), "jaxstab\n", 8) != 0)
        return 0;
    *table = length - 48;
    for (int i = 7; i >= 0; i--)
        size = size << 8 | bytes[*table + 8 + (size_t)i];
    *image = (size_t)size;
    jaxstab_sha256_(bytes, *table, digest);
    return size <= *table && memcmp(bytes + *table + 16, digest, sizeof digest) == 0;
}

/* Whether there is a file, and no pipe or device, which would be waited for. */
static inline int jaxstab_is_file_(const char *path)
{
#ifdef JAXSTAB_HAS_STAT_
    struct stat status;
    return stat(path, &status) == 0 && S_ISREG(status.st_mode);
#else
    return path != NULL;
#endif
}

/* Return all bytes of a file, to be freed; NULL where it cannot be read. */
static inline unsigned char *jaxstab_bytes_of_(const char *path, size_t *length)
{
    FILE *file = jaxstab_is_file_(path) ? fopen(path, "rb") : NULL;
    unsigned char *bytes = NULL;
    long end = -1;
    if (file && fseek(file, 0, SEEK_END) == 0)
        end = ftell(file);
    if (end >= 0 && end < LONG_MAX) /* which is the length of a folder */
        bytes = (unsigned char *)malloc((size_t)end + 1);
    if (bytes && !(fseek(file, 0, SEEK_SET) == 0 &&
                   fread(bytes, 1, (size_t)end, file) == (size_t)end)) {
        free(bytes);
        bytes = NULL;
    }
    if (file)
        fclose(file);
    *length = bytes ? (size_t)end : 0;
    return bytes;
}

#endif
