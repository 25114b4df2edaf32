// Sums and products of four numbers at once, with what the compiler has for them or, with GAINROOM_PLAIN, one by one.
#include <cstdio>

#include "gainroom/four.hpp"

int main() {
    double values[8], out[4];
    for (int k = 0; k < 8; k++) values[k] = 1.0 / (k + 3) - 0.2 * k;
    const gainroom::Four a = gainroom::four(values), b = gainroom::four(values + 3);
    gainroom::Four sum = a * b - 0.3 * a;
    sum += b + a;
    sum = 1.0 / (sum + 7.0);
    gainroom::put(out, sum);
    for (double one : out) std::printf("%a ", one);
}
