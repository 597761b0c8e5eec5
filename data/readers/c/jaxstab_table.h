/* Arrays from the file of a jaxstab atlas. Part of jaxstab_atlas.h, standard C99 alone.
 *
 * A file begins with an HDF5 image, which is not looked at as such; after it a table says where the
 * chunks of each array lie, and after that comes the footer (data/README.md).
 */
#ifndef JAXSTAB_TABLE_H
#define JAXSTAB_TABLE_H

#include "jaxstab_footer.h"

#define JAXSTAB_FILTERS_ "\nfilters " /* before words in the head */
#define JAXSTAB_LARGEST_ARRAY_ ((uint64_t)1 << 28) /* numbers */

static const char jaxstab_damaged_[] =
    "is damaged, or no jaxstab atlas; build it again or copy it anew.";

typedef struct {
    const unsigned char *image;
    uint64_t rest;   /* bytes of the image that no chunk was found in yet */
    char *blocks[3]; /* the table: head, lines of shapes and digests, lines of places */
} jaxstab_file_;

typedef struct {
    uint64_t shape[5], chunk[5]; /* from the last dimension on, 1 beyond the first */
    uint64_t count, chunks, size; /* all numbers, all chunks, and bytes of a chunk */
    uint64_t width;               /* bytes of a number */
    const char *digests, *places; /* of the chunks */
} jaxstab_stored_;

/* Take a word from a text; 0 where it is another. */
static inline int jaxstab_take_(const char **text, const char *word)
{
    const size_t length = strlen(word);
    const int is_there = strncmp(*text, word, length) == 0;
    *text += is_there ? length : 0;
    return is_there;
}

/* Take a number of at most 12 digits from a text; 0 where there is none. */
static inline int jaxstab_take_number_(const char **text, uint64_t *number)
{
    const char *start = *text;
    for (*number = 0; **text >= '0' && **text <= '9' && *text - start < 12; ++*text)
        *number = *number * 10 + (uint64_t)(**text - '0');
    return *text > start;
}

/* Take " 3x2x4", outer dimensions first, with each number from 1 on. */
static inline int jaxstab_take_shape_(const char **text, int rank, uint64_t shape[5])
{
    int is_right = 1;
    for (int i = rank - 1; is_right && i >= 0; i--)
        is_right = jaxstab_take_(text, i == rank - 1 ? " " : "x") &&
                   jaxstab_take_number_(text, &shape[i]) && shape[i] > 0;
    for (int i = rank; i < 5; i++)
        shape[i] = 1;
    return is_right;
}

/* Return what follows a name at the beginning of a line; NULL where there is no such line. */
static inline const char *jaxstab_line_(const char *block, const char *name)
{
    for (const char *line = block; *line; line++) {
        const char *rest = line;
        if (jaxstab_take_(&rest, name) && *rest == ' ')
            return rest;
        line = strchr(line, '\n');
        if (!line)
            break;
    }
    return NULL;
}

/* Find an array of a type, " <f8", " <f4" or " <i4", in the table; 0 where it is missing, or
 * promises more than there is. */
static inline int jaxstab_stored_of_(const jaxstab_file_ *file, const char *name, const char *type,
                                     int rank, jaxstab_stored_ *stored)
{
    const uint64_t width = (uint64_t)(type[3] - '0');
    const char *line = jaxstab_line_(file->blocks[1], name);
    stored->places = jaxstab_line_(file->blocks[2], name);
    if (!line || !stored->places || !jaxstab_take_(&line, type) ||
        !jaxstab_take_shape_(&line, rank, stored->shape) ||
        !jaxstab_take_shape_(&line, rank, stored->chunk))
        return 0;
    uint64_t inside = stored->count = stored->chunks = 1;
    for (int i = 0; i < rank; i++) {
        const uint64_t whole = stored->shape[i], part = stored->chunk[i];
        if (part > whole || stored->count > JAXSTAB_LARGEST_ARRAY_ / whole)
            return 0;
        stored->count *= whole;
        stored->chunks *= (whole - 1) / part + 1;
        inside *= part;
    }
    stored->digests = line;
    stored->width = width;
    stored->size = inside * width + 4; /* with the checksum of HDF5 */
    return stored->chunks <= file->rest / stored->size;
}

/* Copy one chunk into its array, the bytes of its values one after the other as well; return how
 * many values those are. */
static inline size_t jaxstab_copy_chunk_(const jaxstab_stored_ *stored, uint64_t number,
                                         const unsigned char *chunk, unsigned char *values,
                                         unsigned char *ordered)
{
    const size_t wide = (size_t)stored->width;
    uint64_t start[5], size[5], step[5], next = 1, count = 1;
    for (int i = 0; i < 5; i++) {
        const uint64_t along = (stored->shape[i] - 1) / stored->chunk[i] + 1;
        start[i] = number % along * stored->chunk[i];
        size[i] = stored->shape[i] - start[i] < stored->chunk[i] ? stored->shape[i] - start[i]
                                                                 : stored->chunk[i];
        number /= along;
        count *= size[i];
        step[i] = next;
        next *= stored->shape[i];
    }
    for (uint64_t k = 0; k < count; k++) {
        uint64_t rest = k, from = 0, to = 0, width = 1, bits = 0;
        for (int i = 0; i < 5; i++) {
            const uint64_t place = rest % size[i];
            rest /= size[i];
            from += place * width;
            to += (start[i] + place) * step[i];
            width *= stored->chunk[i];
        }
        const unsigned char *bytes = chunk + wide * from;
        memcpy(ordered + wide * k, bytes, wide);
        for (size_t i = wide; i-- > 0;)
            bits = bits << 8 | bytes[i];
        const uint32_t low_bits = (uint32_t)bits;
        memcpy(values + wide * to, wide == 8 ? (const void *)&bits : (const void *)&low_bits, wide);
    }
    return (size_t)count;
}

/* Fill in an array from its chunks; 0 where one is not what its digest says. */
static inline int jaxstab_fill_(jaxstab_file_ *file, size_t length, jaxstab_stored_ *stored,
                                unsigned char *values, unsigned char *ordered)
{
    for (uint64_t number = 0; number < stored->chunks; number++) {
        uint64_t offset, size;
        if (!jaxstab_take_(&stored->places, " ") ||
            !jaxstab_take_number_(&stored->places, &offset) ||
            !jaxstab_take_(&stored->places, "+") ||
            !jaxstab_take_number_(&stored->places, &size) || size != stored->size ||
            offset > length || size > length - offset || !jaxstab_take_(&stored->digests, " "))
            return 0;
        const size_t count =
            jaxstab_copy_chunk_(stored, number, file->image + offset, values, ordered);
        if (!jaxstab_has_digest_(ordered, (size_t)stored->width * count, stored->digests))
            return 0;
        stored->digests += 64;
        file->rest -= size;
    }
    return *stored->places == '\n' && *stored->digests == '\n';
}

/* Return the numbers of an array, to be freed, and its shape; or NULL. */
static inline void *jaxstab_read_(jaxstab_file_ *file, size_t length, const char *name,
                                  const char *type, int rank, size_t *shape)
{
    jaxstab_stored_ stored;
    if (!jaxstab_stored_of_(file, name, type, rank, &stored))
        return NULL;
    unsigned char *values = (unsigned char *)malloc((size_t)(stored.count * stored.width));
    unsigned char *ordered = (unsigned char *)malloc((size_t)stored.size);
    if (!values || !ordered || !jaxstab_fill_(file, length, &stored, values, ordered)) {
        free(values);
        values = NULL;
    }
    free(ordered);
    for (int i = 0; i < rank; i++)
        shape[i] = (size_t)stored.shape[rank - 1 - i];
    return values;
}

/* Split the text of a table, which is changed, and check its head and digest; 0 or the problem. */
static inline const char *jaxstab_parse_(char *text, size_t length, char *blocks[3])
{
    const char *head = text;
    if (!jaxstab_take_(&head, "jaxstab atlas 3\n"))
        return "has another schema version than 3, or none; use another reader, or build it again.";
    blocks[0] = text;
    for (int i = 1; i < 3; i++) {
        char *end = strstr(blocks[i - 1], "\n\n");
        if (!end)
            return jaxstab_damaged_;
        end[1] = 0;
        blocks[i] = end + 2;
    }
    head = strstr(text, "\ncontent ");
    if (strlen(blocks[2]) + (size_t)(blocks[2] - text) != length || !head ||
        !strstr(text, JAXSTAB_FILTERS_) ||
        !jaxstab_has_digest_((const unsigned char *)blocks[1], strlen(blocks[1]), head + 9))
        return jaxstab_damaged_;
    if (!jaxstab_line_(blocks[1], "alpha_limits"))
        return "holds no limits of alpha; build one with the product 'alpha_limits'.";
    return NULL;
}

#endif
