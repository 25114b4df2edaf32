// Complex numbers from standard input, in hexadecimal, so that no digit is lost.
#pragma once

#include <cstdio>
#include <vector>

#include "gainroom/complex.hpp"

inline std::vector<gainroom::Complex> pairs(int count) {
    std::vector<gainroom::Complex> found;
    for (int k = 0; k < count; k++) {
        double real = 0.0, imag = 0.0;
        if (std::scanf("%la %la", &real, &imag) != 2) break;
        found.emplace_back(real, imag);
    }
    return found;
}
