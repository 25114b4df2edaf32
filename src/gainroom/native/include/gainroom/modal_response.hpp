// P (n, n) of a ModalLoop, behind what its functions stand behind: from its modes, anywhere about jω.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "mode_sum.hpp"

namespace gainroom {

class ModalResponse {
public:
    explicit ModalResponse(const ModalLoop& loop)
        : loop_(loop), sum_(loop_), real_(loop.size * sum_.stride), imaginary_(loop.size * sum_.stride) {
        sum_.set_units(std::vector<double>(loop.size, 1.0));
    }
    ModalResponse(const ModalResponse&) = delete;
    ModalResponse& operator=(const ModalResponse&) = delete;

    // Whether s is so near to jω that the functions serve.
    static bool serves(Complex s) { return std::fabs(s.real()) < 1e-6 * s.imag(); }

    // At such an s.
    void at(Complex s, Complex* out) {
        sum_.respond(s, real_.data(), imaginary_.data());
        const double scale = 1 / Cell::weight(s.imag(), loop_.step);
        for (std::size_t i = 0; i < loop_.size; i++)
            for (std::size_t j = i; j < loop_.size; j++) {
                const std::size_t entry = i * sum_.stride + j;
                out[i * loop_.size + j] = out[j * loop_.size + i] = {scale * real_[entry], scale * imaginary_[entry]};
            }
    }

private:
    ModalLoop loop_;
    ModeSum sum_;
    std::vector<double> real_, imaginary_;
};

}  // namespace gainroom
