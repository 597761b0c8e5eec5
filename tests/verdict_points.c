/* What jaxstab_verdict.h says, for numbers in binary on the standard input.
 *
 * Without an argument: points in, codes out. "loops": points in; 65 coefficients and their errors out.
 * "polynomials": seven coefficients in, codes out. */
#include "jaxstab_verdict.h"

#include <stdio.h>
#include <string.h>

int main(int count, char **arguments)
{
    const int are_loops = count > 1 && strcmp(arguments[1], "loops") == 0;
    const size_t size = count > 1 && !are_loops ? 7 : 5;
    double in[7], both[2][JAXSTAB_DEGREE + 1];
    while (fread(in, sizeof(double), size, stdin) == size) {
        if (are_loops) {
            memset(both, 0, sizeof both);
            (void)jaxstab_loop(in[0], in[1], in[2], in[3], in[4], both[0], both[1]);
            fwrite(both, sizeof both, 1, stdout);
        } else {
            const double code = size == 7 ? jaxstab_polynomial_verdict(in, 6)
                                          : jaxstab_verdict(in[0], in[1], in[2], in[3], in[4]);
            fwrite(&code, sizeof code, 1, stdout);
        }
    }
    return 0;
}
