// What is known of a coupled loop at one frequency.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "directed_loop.hpp"
#include "locus_step.hpp"

namespace gainroom {

inline Complex return_ratio(Complex sensitivity) { return over(1.0, sensitivity == 0.0 ? Complex(1e-300) : sensitivity) - 1.0; }

struct LoopSample {
    std::shared_ptr<const LoopPoint> point;
    std::vector<Complex> law, sensitivity, ratios;  // d (m), S_ii (n), return ratios (n)
    std::vector<Complex> reached;           // ((I + Q)⁻¹ E P X)_ii (n): T_ii over the law, where that may be 0; else empty
    std::vector<Complex> inverse;           // (I + L)⁻¹ (m, m), or empty: of what is kept only where it is not `near`
    Loci loci;                              // (m)
    Complex log_determinant;
    bool near = false;                 // some |μ| may be as large as is wanted
    const LoopSample* next = nullptr;  // with which this interval was found fine enough
    std::vector<std::size_t> pairs;    // of the loci there with those of `next`
    double turned = 0.0;               // by arg det(I + L) over it

    double omega() const { return point->omega; }

    // T_ii, T = I − S, or ((I + Q)⁻¹ E P X)_ii times what one gain multiplies.
    Complex closed(std::size_t i, Gain gain) const {
        const Complex own = 1.0 - sensitivity[i];
        if (gain == Gain::all) return own;
        return times(reached.empty() ? over(own, law[i]) : reached[i], DirectedLoop::unit(*point, gain));
    }

    // Of S_ii.
    void find_ratios() {
        ratios.resize(sensitivity.size());
        for (std::size_t i = 0; i < sensitivity.size(); i++) ratios[i] = return_ratio(sensitivity[i]);
    }
};

}  // namespace gainroom
