// Products, sums and differences of numbers of 320 bits, and e^x: of each line "a b c d" those of x = a + b/2^90 and y = c + d/2^90,
// as six doubles whose sum it is.
#include <cstdio>

#include "gainroom/extended.hpp"

using gainroom::Extended;

static void print(Extended rest) {
    for (int k = 0; k < 6; k++) {
        const double part = rest.to_double();
        std::printf("%a ", part);
        rest = rest - Extended(part);
    }
}

int main() {
    double a, b, c, d;
    while (std::scanf("%la %la %la %la", &a, &b, &c, &d) == 4) {
        const Extended x = Extended(a) + Extended(b).shifted(-90), y = Extended(c) + Extended(d).shifted(-90);
        for (const Extended& each : {x * y, x + y, x - y, gainroom::exponential(gainroom::ExtendedComplex(x)).real}) print(each);
        std::printf("\n");
    }
}
