// P C e^{−sT} of several joints, torque command → measured position, anywhere in the complex plane.
#pragma once

#include <cmath>
#include <cstddef>
#include <memory>
#include <vector>

#include "complex.hpp"
#include "dense.hpp"
#include "factors.hpp"
#include "modal_response.hpp"

namespace gainroom {

// All matrices by rows. Continuous (step 0), as Plant.response has it, so that neither W nor K is inverted:
//   P = (1/s²) X (I + J Z)⁻¹,  Z = W(s) + s² diag(1/(K + s B)),  X = Z for encoders on the motors, W(s) on the links,  J = J_m + D_m/s,
//   W(s) = R (I + Rᵀ (D_l/s + G/s²) R)⁻¹ Rᵀ with W = R Rᵀ, or W − W_c (W_cc + s² diag(1/(K_c + s B_c)))⁻¹ W_cᵀ, then (I + W(s) load)⁻¹ W(s).
// Sampled: C (v I − A)⁻¹ B and whole ticks of delay. In Hessenberg form where |v| is not far below the size of A: what orthogonal
// transformations mix, integrators and fast states, loses (|A|/v)² of its digits.
struct StateForm {
    std::vector<double> a, b, c;  // (N, N), (N, n), (n, N)
};

struct Actuated {
    std::size_t size = 0;
    double step = 0.0;
    // continuous
    bool motor_side = true, loaded = false;
    std::vector<double> mobility, motor_inertia, motor_viscous, stiffness, damping, link_viscous;  // stiffness may be infinite
    std::vector<double> root, gravity;                                                            // R (n, r), W = R Rᵀ; G (n, n)
    std::vector<double> hung, contact_stiffness, contact_damping;                                 // H (c, r), (c): Plant.hung
    std::vector<double> bandwidth, damping_ratio;                                                 // of the current loops
    // sampled
    StateForm whole, hessenberg;
    double fast = 0.0;  // |v| from which on Hessenberg form serves
    // where they are known, and s is about jω: they take a tenth of the time
    std::unique_ptr<ModalResponse> modes;
    // [s] of a delay that is an exact factor: all of it in continuous time, whole ticks in sampled time
    std::vector<double> delay;

    struct Workspace {
        Dense system, links;
        std::vector<Complex> drives;
    };

    // out (n, n); false where s is a pole.
    bool at(Complex s, Workspace& work, Complex* out) const {
        if (modes != nullptr && ModalResponse::serves(s)) {
            modes->at(s, out);
        } else if (!(step > 0 ? held(variable(s, step), work, out) : plant(s, work, out))) {
            return false;
        }
        work.drives.resize(size);
        for (std::size_t j = 0; j < size; j++)
            work.drives[j] = j > 0 && same_drive(j, j - 1) ? work.drives[j - 1] : times(lag(j, s), std::exp(-s * delay[j]));
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = 0; j < size; j++) out[i * size + j] = times(out[i * size + j], work.drives[j]);
        return true;
    }

private:
    bool same_drive(std::size_t j, std::size_t k) const {
        return delay[j] == delay[k] && (step > 0 || (bandwidth[j] == bandwidth[k] && damping_ratio[j] == damping_ratio[k]));
    }

    Complex lag(std::size_t j, Complex s) const {
        if (step > 0) return 1.0;
        const Complex x = s / bandwidth[j];  // 0 where the current loop is ideal
        return over(1.0, times(x, x) + 2 * damping_ratio[j] * x + 1.0);
    }

    bool held(Complex v, Workspace& work, Complex* out) const {
        const bool quick = std::abs(v) >= fast;
        const auto& [a, b, c] = quick ? hessenberg : whole;
        const std::size_t order = b.size() / size;
        if (order == 0) return false;  // known by its modes alone
        Dense& system = work.system;
        system.resize(order, order + size);
        for (std::size_t r = 0; r < order; r++) {
            for (std::size_t k = 0; k < order; k++) system.re[r * system.columns + k] = -a[r * order + k];
            for (std::size_t k = 0; k < size; k++) system.re[r * system.columns + order + k] = b[r * size + k];
            system.set(r, r, system.at(r, r) + v);
        }
        if (!solve(system, quick)) return false;
        for (std::size_t i = 0; i < size; i++)
            for (std::size_t j = 0; j < size; j++) {
                Complex sum = 0.0;
                for (std::size_t k = 0; k < order; k++) sum += c[i * order + k] * system.at(k, order + j);
                out[i * size + j] = sum;
            }
        return true;
    }

    // W(s) into work.links.
    bool links(Complex s, Workspace& work) const {
        const std::size_t n = size, contacts = contact_stiffness.size();
        Dense &w = work.links, &system = work.system;
        w.resize(n, n);
        w.re.assign(mobility.begin(), mobility.end());
        if (contacts == 0 && !loaded) return true;
        const Complex inverse = over(1.0, s), square = times(inverse, inverse);
        const auto load = [&](std::size_t i, std::size_t j) {
            const Complex weight = gravity.empty() ? Complex(0.0) : gravity[i * n + j] * square;
            return i == j ? weight + link_viscous[i] * inverse : weight;
        };
        const std::size_t rank = root.size() / n;
        system.resize(rank, rank + n);
        std::vector<Complex> loaded_root(n * rank, 0.0), springs(contacts);
        for (std::size_t c = 0; c < contacts; c++) springs[c] = times(contact_stiffness[c] + s * contact_damping[c], square);
        for (std::size_t i = 0; loaded && i < n; i++)
            for (std::size_t k = 0; k < n; k++) {
                const Complex entry = load(i, k);
                if (entry != 0.0)
                    for (std::size_t r = 0; r < rank; r++) loaded_root[i * rank + r] += entry * root[k * rank + r];
            }
        for (std::size_t r = 0; r < rank; r++) {
            for (std::size_t k = 0; k < rank; k++) {
                Complex sum = r == k ? 1.0 : 0.0;
                for (std::size_t i = 0; loaded && i < n; i++) sum += root[i * rank + r] * loaded_root[i * rank + k];
                for (std::size_t c = 0; c < contacts; c++) sum += hung[c * rank + r] * hung[c * rank + k] * springs[c];
                system.set(r, k, sum);
            }
            for (std::size_t j = 0; j < n; j++) system.set(r, rank + j, root[j * rank + r]);
        }
        if (!solve(system)) return false;
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) {
                Complex sum = 0.0;
                for (std::size_t k = 0; k < rank; k++) sum += root[i * rank + k] * system.at(k, rank + j);
                w.set(i, j, sum);
            }
        return true;
    }

    bool plant(Complex s, Workspace& work, Complex* out) const {
        if (!links(s, work)) return false;
        const std::size_t n = size;
        Dense &w = work.links, &system = work.system;
        const Complex square = times(s, s), inverse = over(1.0, s);
        system.resize(n, 2 * n);
        for (std::size_t j = 0; j < n; j++) {
            const Complex motor = motor_inertia[j] + motor_viscous[j] * inverse;
            const Complex gearbox = std::isfinite(stiffness[j]) ? over(square, stiffness[j] + s * damping[j]) : Complex(0.0);
            for (std::size_t i = 0; i < n; i++) {  // row i of the transposed equations: column i of I + J Z, and of X
                Complex link = w.at(j, i), whole = i == j ? link + gearbox : link;
                system.set(i, j, times(motor, whole) + (i == j ? 1.0 : 0.0));
                system.set(i, n + j, motor_side ? whole : link);
            }
        }
        if (!solve(system)) return false;
        const Complex factor = times(inverse, inverse);
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) out[i * n + j] = times(factor, system.at(j, n + i));
        return true;
    }
};

}  // namespace gainroom
