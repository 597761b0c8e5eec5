/* Opens many atlases in one process: names of files in, a line for each out.
 *
 *     open_many POINTS     POINTS: a file of alpha, beta, gamma, delta, delay as doubles
 *
 * A line is "refused" and why, or "answered" and a digit for the code of each point. */
#include "jaxstab_atlas.h"

int main(int count, char **arguments)
{
    static double points[4096][5];
    char name[4096];
    const char *problem;
    FILE *file = count == 2 ? fopen(arguments[1], "rb") : NULL;
    if (!file)
        return 2;
    const size_t given = fread(points, sizeof *points, 4096, file);
    fclose(file);
    while (fgets(name, sizeof name, stdin)) {
        name[strcspn(name, "\n")] = 0;
        jaxstab_atlas *atlas = jaxstab_open(name, &problem);
        if (!atlas) {
            printf("refused %s\n", problem);
        } else {
            printf("answered ");
            for (size_t i = 0; i < given; i++) {
                const double *p = points[i];
                jaxstab_limits limits;
                putchar('1' + jaxstab_verdict(atlas, p[0], p[1], p[2], p[3], p[4]));
                jaxstab_alpha_limits(atlas, p[1], p[2], p[3], p[4], &limits);
            }
            putchar('\n');
        }
        jaxstab_close(atlas);
        fflush(stdout);
    }
    return 0;
}
