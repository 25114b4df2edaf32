// Eigenvectors of √J W √J by Jacobi's rotations, some at a time: where joints are alike, the modes of all crossings are √J times these.
//
// Joints that are not alike have crossings apart, at gains that go with J/kd, and are not mixed.
//
// Along a count each of them has a locus g(ω), complex: the factor at which a root would lie at jω. Where it becomes real is a start of a
// search; nothing else is concluded from it. From one search to the next W has moved a little, and the rotations begin
// with the vectors as they were.
#pragma once

#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "joint_law.hpp"

namespace gainroom {

class ModeBasis {
public:
    explicit ModeBasis(const JointLaws& laws)
        : size_(laws.size()), scale_(size_), push_(size_), give_(size_), matrix_(size_ * size_), vectors_(size_ * size_), work_(size_ * size_) {
        for (std::size_t i = 0; i < size_; i++) {
            scale_[i] = std::sqrt(laws.joint(i).motor_inertia);
            vectors_[i * size_ + i] = 1.0;
            for (std::size_t j = 0; j < size_; j++) {
                const double ratio = laws.joint(i).kd * laws.joint(j).motor_inertia / (laws.joint(j).kd * laws.joint(i).motor_inertia);
                mixed_.push_back(ratio < kAlike && ratio > 1.0 / kAlike);
            }
        }
    }

    // The matrix in the vectors that are there.
    void begin(const double* w) {  // its diagonal becomes λ
        const std::size_t n = size_;
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) work_[i * n + j] = matrix_[i * n + j] = 0.0;
        for (std::size_t i = 0; i < n; i++)  // work = V √J W √J
            for (std::size_t k = 0; k < n; k++) {
                const double v = vectors_[i * n + k] * scale_[k];
                for (std::size_t j = 0; j < n; j++) work_[i * n + j] += v * w[k * n + j] * scale_[j];
            }
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j <= i; j++) {
                double sum = 0.0;
                for (std::size_t k = 0; k < n; k++) sum += work_[i * n + k] * vectors_[j * n + k];
                matrix_[i * n + j] = matrix_[j * n + i] = sum;
            }
        row_ = sweeps_ = 0;
        turned_ = 0.0;
    }

    bool ready() const { return sweeps_ >= kSweeps; }

    // One row's rotations.
    void rotate() {
        const std::size_t n = size_, p = row_;
        for (std::size_t q = p + 1; q < n; q++) {
            if (!mixed_[p * n + q]) continue;
            const double off = matrix_[p * n + q], difference = matrix_[q * n + q] - matrix_[p * n + p];
            if (!(std::fabs(off) > 1e-300)) continue;
            const double ratio = difference / (2.0 * off);
            const double t = (ratio < 0.0 ? -1.0 : 1.0) / (std::fabs(ratio) + std::sqrt(ratio * ratio + 1.0));
            const double c = 1.0 / std::sqrt(t * t + 1.0), s = t * c;
            turned_ = std::fmax(turned_, std::fabs(t));
            turn(&vectors_[p * n], &vectors_[q * n], c, s);
            turn(&matrix_[p * n], &matrix_[q * n], c, s);
            for (std::size_t k = 0; k < n; k++) {
                const double a = matrix_[k * n + p], b = matrix_[k * n + q];
                matrix_[k * n + p] = c * a - s * b;
                matrix_[k * n + q] = s * a + c * b;
            }
        }
        if (++row_ + 1 >= n) {
            row_ = 0;
            sweeps_ = turned_ < kTurned ? kSweeps : sweeps_ + 1;  // angles are squared from one to the next
            turned_ = 0.0;
        }
    }

    // At the frequency of `values`, which are of the factor `gain`, for `locus`. With S = √J W √J = Σ λ y yᵀ, joints alike:
    // 1 + g c/(J s²) = −1/(λ + J e); where they differ, means over the mode stand for c/J and J e.
    void at(const JointValue* values, double gain) {
        gain_ = gain;
        for (std::size_t i = 0; i < size_; i++) {
            const double inertia = scale_[i] * scale_[i];
            const JointValue& value = values[i];
            push_[i] = value.inner / inertia - 1.0;
            give_[i] = inertia * over(times(value.beta, value.outer) - 1.0, value.inner);
        }
    }

    // Of one mode there.
    Complex locus(std::size_t k) const {
        Complex push = 0.0, give = matrix_[k * size_ + k];
        for (std::size_t i = 0; i < size_; i++) {
            const double share = vectors_[k * size_ + i] * vectors_[k * size_ + i];
            push += share * push_[i];
            give += share * give_[i];
        }
        return gain_ * over(-1.0 - over(1.0, give), push);
    }

    void mode(std::size_t k, Complex* x) const {
        for (std::size_t i = 0; i < size_; i++) x[i] = scale_[i] * vectors_[k * size_ + i];
    }

private:
    static constexpr std::size_t kSweeps = 5;
    static constexpr double kAlike = 1.5, kTurned = 0.03;

    void turn(double* a, double* b, double c, double s) const {
        for (std::size_t k = 0; k < size_; k++) {
            const double left = a[k], right = b[k];
            a[k] = c * left - s * right;
            b[k] = s * left + c * right;
        }
    }

    std::size_t size_, row_ = 0, sweeps_ = 0;
    double gain_ = 1.0, turned_ = 0.0;
    Vector<double> scale_;
    Vector<Complex> push_, give_;
    Vector<double> matrix_, vectors_, work_;
    Vector<char> mixed_;  // of each pair of joints
};

}  // namespace gainroom
