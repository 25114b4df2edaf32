// One frequency of a coupled loop: its loci, S_ii, (I + L)⁻¹ and ln det(I + L), each by the quickest way that is exact there.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "block.hpp"
#include "complex.hpp"
#include "dense.hpp"
#include "directed_loop.hpp"
#include "eigenvalues.hpp"
#include "loop_sample.hpp"
#include "symmetric_eigenvalues.hpp"
#include "symmetric_factor.hpp"

namespace gainroom {

class SampleSolver {
public:
    explicit SampleSolver(const DirectedLoop& loop) : loop_(loop), m_(loop.directions), factor_(m_), work_(SymmetricFactor::room(m_)) {}

    // A sample with its law, of any gains.
    LoopSample begun(std::shared_ptr<const LoopPoint> point, const DirectedGains& gains) const {
        LoopSample found;
        found.point = std::move(point);
        found.law.resize(m_);
        loop_.law(*found.point, gains, found.law.data());
        return found;
    }

    // Inverse, S_ii and ln det; false where I + L is singular.
    bool close(LoopSample& sample) {
        fill(*sample.point, sample.law.data());
        for (std::size_t i = 0; i < m_; i++) dense_.re[i * m_ + i] += 1.0;
        LogDeterminant determinant;
        if (!invert(dense_, exchanged_, determinant)) return false;
        sample.log_determinant = determinant.value();
        sample.inverse.resize(m_ * m_);
        for (std::size_t k = 0; k < m_ * m_; k++) sample.inverse[k] = Complex(dense_.re[k], dense_.im[k]);
        sample.sensitivity.resize(loop_.loops());
        for (std::size_t i = 0; i < loop_.loops(); i++)
            sample.sensitivity[i] = loop_.own() ? sample.inverse[i * m_ + i] : own_sensitivity(sample, i);
        sample.find_ratios();
        if (!loop_.own() || std::none_of(sample.law.begin(), sample.law.end(), [](Complex d) { return d == 0.0; })) return true;
        sample.reached.assign(m_, 0.0);
        for (std::size_t i = 0; i < m_; i++)
            for (std::size_t k = 0; k < m_; k++) sample.reached[i] += times(sample.inverse[i * m_ + k], sample.point->seen[k * m_ + i]);
        return true;
    }

    // Loci, in units of the joints in which L is symmetric; false where there are none, or they are not sure.
    bool find_symmetric(LoopSample& sample) {
        sample.loci.values.resize(m_);
        return by_symmetry(*sample.point, sample.law.data(), sample.loci.values.data());
    }

    // S_ii and ln det of loops of which find_symmetric has just found loci, without the inverse; false where that loses digits.
    bool close_symmetric(LoopSample& sample) {
        factor_.factor([&](std::size_t i, std::size_t j) { return times(dense_.at(i, j), symmetric_.unit(i, j)) + (i == j ? 1.0 : 0.0); });
        if (!(factor_.largest() < kGrown)) return false;
        LogDeterminant determinant;
        for (std::size_t k = 0; k < m_; k++) determinant.multiply(factor_.pivot(k));
        sample.log_determinant = determinant.value();
        sample.sensitivity.resize(m_);
        factor_.inverse_diagonal(work_.data(), sample.sensitivity.data());
        sample.find_ratios();
        return true;
    }

    // Loci of a sample that is closed; false where they do not settle.
    bool find_other(LoopSample& sample) {
        Complex* values = sample.loci.values.data();
        return by_inverse(sample, values) || by_all(*sample.point, sample.law.data(), values);
    }

    // Eigenvalues of L at a point, with d (m); false where the iteration does not converge.
    bool eigenvalues(const LoopPoint& point, const Complex* law, Complex* found) { return by_symmetry(point, law, found) || by_all(point, law, found); }

private:
    static constexpr double kOff = 1e-8;  // so far symmetric eigenvalues of 1 may be off, about; of 1e-3, which a factor of 1000 brings to −1, 1e-5
    static constexpr double kGrown = 100.0;  // an entry of a factor without exchanges of rows, which loses as many digits twice
    static constexpr double kInverted = 1e-9, kTogether = 1e-4;  // so far an inverse is not symmetric; the product of all 1 + λ beside the determinant

    // L (m, m).
    void fill(const LoopPoint& point, const Complex* law) {
        dense_.shape(m_, m_);
        for (std::size_t i = 0; i < m_; i++)
            for (std::size_t j = 0; j < m_; j++) dense_.set(i, j, times(point.seen[i * m_ + j], law[j]));
    }

    bool by_symmetry(const LoopPoint& point, const Complex* law, Complex* found) {
        fill(point, law);
        return symmetric_.find(dense_.re.data(), dense_.im.data(), m_, kOff, found);
    }

    bool by_all(const LoopPoint& point, const Complex* law, Complex* found) {
        fill(point, law);
        return eigenvalues_.find(dense_.re.data(), dense_.im.data(), m_, found);
    }

    // λ from the eigenvalues 1/(1 + λ) of (I + L)⁻¹, whose entries are small where those of L are large; false where they are not sure.
    bool by_inverse(const LoopSample& sample, Complex* found) {
        dense_.shape(m_, m_);
        dense_.copy(sample.inverse.data());
        if (!symmetric_.find(dense_.re.data(), dense_.im.data(), m_, kOff, found, kInverted)) return false;
        LogDeterminant product;  // large λ stand for small eigenvalues, which sums do not tell
        for (std::size_t k = 0; k < m_; k++) {
            if (!(std::norm(found[k]) > 0)) return false;
            product.multiply(found[k]);
            found[k] = over(1.0, found[k]) - 1.0;
        }
        return size_of_any(std::exp(product.value() + sample.log_determinant) - 1.0) < kTogether;
    }

    Complex own_sensitivity(const LoopSample& sample, std::size_t i) const {  // S_ii = 1 − (P X Δ (I + E P X Δ)⁻¹ E)_ii
        const std::size_t n = loop_.size();
        Complex sum = 1.0;
        for (std::size_t k = 0; k < m_; k++) {
            Complex row = 0.0;
            for (std::size_t j = 0; j < m_; j++) row += times(times(sample.point->reached[i * m_ + j], sample.law[j]), sample.inverse[j * m_ + k]);
            sum -= row * loop_.jacobian[k * n + i];
        }
        return sum;
    }

    const DirectedLoop& loop_;
    std::size_t m_;
    Dense dense_;
    Vector<std::size_t> exchanged_;
    Eigenvalues eigenvalues_;
    SymmetricEigenvalues symmetric_;
    SymmetricFactor factor_;
    std::vector<double> work_;
};

}  // namespace gainroom
