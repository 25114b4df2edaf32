// Factors of the return ratio over a box: those of the plant, sizes of a product, and the derivative of its logarithm by each parameter.
#pragma once

#include "discs.hpp"

namespace gainroom {

// The plant as a ratio of factors, up to sign: one complex factor at most above the line and one below, and at least one that is real
// below. T: double, Disc, or Ball where slopes are asked for.
template <class T>
struct PlantFactors {
    double sign = 1.0;
    int reals = 0;
    bool has_above = false, has_below = false;
    T real[3], above[2], below[2];  // of the complex ones, real and imaginary part

    void divide(const T& factor) { real[reals++] = factor; }
    void divide(const T& x, const T& y) { below[0] = x, below[1] = y, has_below = true; }
    void multiply(const T& x, const T& y) { above[0] = x, above[1] = y, has_above = true; }

    static auto whole(const T (&factor)[2]) { return joined(disc_of(factor[0]), disc_of(factor[1])); }

    auto value() const {
        auto product = sign * inverse(disc_of(real[0]));
        for (int k = 1; k < reals; k++) product = product * inverse(disc_of(real[k]));
        auto found = as_complex(product);
        if (has_above) found = times(found, whole(above));
        return has_below ? times(found, inverse(whole(below))) : found;
    }

    auto inverse_value() const {
        auto product = sign * disc_of(real[0]);
        for (int k = 1; k < reals; k++) product = product * disc_of(real[k]);
        auto found = as_complex(product);
        if (has_below) found = times(found, whole(below));
        return has_above ? times(found, inverse(whole(above))) : found;
    }
};

// Least and largest size of a product.
struct Sizes {
    double least = 1.0, most = 1.0;

    void multiply(double low, double high) { least *= low, most *= high; }
    void divide(double low, double high) { least /= high, most /= low; }
    void multiply(const ComplexDisc& factor) { multiply(factor.least(), factor.most()); }
    void divide(const ComplexDisc& factor) { divide(factor.least(), factor.most()); }
};

// How log L is moved by each parameter.
struct LogSlopes {
    Complex mid[kBoxParameters];
    double rad[kBoxParameters] = {};
    double rough[kBoxParameters] = {};  // by how much factors of L are, where one of them may be 0

    void add(int parameter, Complex slope, double reach) {
        mid[parameter] += slope;
        rad[parameter] += reach;
    }

    // A real factor below the line.
    void divide(const Ball& factor) {
        const Disc below = -1.0 * inverse(factor.disc);
        const double size = std::max(std::fabs(factor.disc.mid), 0.1 * factor.disc.rad);
        for (int i = 0; i < kBoxParameters; i++) {
            const Disc slope = factor.slope(i);
            if (slope.mid == 0 && slope.rad == 0) continue;
            const Disc part = below * slope;
            add(i, part.mid, part.rad);
            rough[i] += (std::fabs(slope.mid) + slope.rad) / size;
        }
    }

    // A complex one, above or (sign −1) below it.
    void multiply(const Ball (&factor)[2], double sign) {
        const ComplexDisc value = PlantFactors<Ball>::whole(factor), below = inverse(value);
        const double size = std::max(value.size, 0.1 * value.rad);
        for (int i = 0; i < kBoxParameters; i++) {
            const Disc x = factor[0].slope(i), y = factor[1].slope(i);
            if (x.mid == 0 && y.mid == 0 && x.rad + y.rad == 0) continue;
            const ComplexDisc slope = joined(x, y), part = times(below, slope);
            add(i, times(sign, part.mid), part.rad);
            rough[i] += slope.most() / size;
        }
    }

    double size(int parameter) const { return magnitude(mid[parameter]) + rad[parameter]; }
};

}  // namespace gainroom
