// The closed loop on Pinocchio's headers: the sampled controller, PID servo and robot, RK4.
#include <pinocchio/fwd.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <chrono>
#include <cmath>

namespace pin = pinocchio;
constexpr int N = JOINTS, P = 12 * N;
using Vec = Eigen::Matrix<double, N, 1>;
using Par = Eigen::Matrix<double, P, 1>;
using Plant = Eigen::Matrix<double, 4 * N, 1>;  // q_c, i, q, dq
using Regressor = Eigen::Matrix<double, N, 10 * N>;
using Rows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Vec3 = Eigen::Vector3d;

struct Reader {
    const double *at;
    double one() { return *at++; }
    template <class M> M take() { M m = Eigen::Map<const M>(at); at += m.size(); return m; }
};

struct Loop {
    pin::Model model, weightless;
    pin::FrameIndex tool;
    double v_0, T, radius, rate, gamma;
    Vec3 center;
    Vec K_c, Lambda, Lambda_P, Lambda_I, K_D, K_P, K_I, B, D, lower[3], upper[3];
    Par Gamma, a_lower, a_upper;

    explicit Loop(Reader in) {
        pin::JointIndex parent = 0;
        for (int j = 0; j < N; ++j) {
            const int kind = int(in.one());
            const Vec3 axis = in.take<Vec3>();
            const Rows R = in.take<Rows>();
            const Vec3 r = in.take<Vec3>();
            const double m = in.one();
            const Vec3 c = in.take<Vec3>();
            const Rows I = in.take<Rows>();
            pin::JointModel joint = pin::JointModelRevoluteUnaligned(axis);
            if (kind == 0) joint = pin::JointModelRX();
            if (kind == 1) joint = pin::JointModelRY();
            if (kind == 2) joint = pin::JointModelRZ();
            parent = model.addJoint(parent, joint, pin::SE3(R, r), "q_" + std::to_string(j));
            model.appendBodyToJoint(parent, pin::Inertia(m, c, I), pin::SE3::Identity());
        }
        model.gravity.linear(in.take<Vec3>());
        const Vec3 point = in.take<Vec3>();
        tool = model.addFrame(pin::Frame("tool", parent, pin::SE3(Rows::Identity(), point), pin::OP_FRAME));
        weightless = model;
        weightless.gravity.setZero();
        v_0 = in.one(), T = in.one();
        center = in.take<Vec3>();
        radius = in.one(), rate = in.one(), gamma = in.one();
        for (Vec *v : {&K_c, &Lambda, &Lambda_P, &Lambda_I, &K_D, &K_P, &K_I, &B, &D}) *v = in.take<Vec>();
        a_lower = in.take<Par>(), a_upper = in.take<Par>();
        for (int k = 0; k < 3; ++k) lower[k] = in.take<Vec>(), upper[k] = in.take<Vec>();
        Gamma = in.take<Par>();
    }
};

struct Controller {
    const Loop &loop;
    pin::Data data, weightless;
    Eigen::Matrix<double, 6, N> J6, dJ6;
    Regressor Y;
    Par a;
    Vec q_r, z, w, w_P, w_I;

    Controller(const Loop &loop, const double *start)
        : loop(loop), data(loop.model), weightless(loop.weightless) {
        Reader in{start};
        a = in.take<Par>();
        for (Vec *v : {&q_r, &z, &w, &w_P, &w_I}) *v = in.take<Vec>();
        J6.setZero(), dJ6.setZero();
    }

    void regressor(const Vec &q, const Vec &dq, const Vec &dq_ref, const Vec &ddq_ref) {
        const Vec half = (dq + dq_ref) / 2, rest = (dq - dq_ref) / 2;
        Y = pin::computeJointTorqueRegressor(loop.model, data, q, half, ddq_ref);
        Y -= pin::computeJointTorqueRegressor(loop.weightless, weightless, q, rest, Vec::Zero());
    }

    Vec step(double t, const Vec &q, const Vec &dq, const Vec &q_c) {
        pin::computeJointJacobiansTimeVariation(loop.model, data, q, dq);
        const Vec3 x = pin::updateFramePlacement(loop.model, data, loop.tool).translation();
        pin::getFrameJacobian(loop.model, data, loop.tool, pin::LOCAL_WORLD_ALIGNED, J6);
        pin::getFrameJacobianTimeVariation(loop.model, data, loop.tool, pin::LOCAL_WORLD_ALIGNED, dJ6);
        const Eigen::Matrix<double, 3, N> J = J6.template topRows<3>(), dJ = dJ6.template topRows<3>();
        const double s = std::sin(loop.rate * t), c = std::cos(loop.rate * t), r = loop.radius, v = loop.rate;
        const Vec3 x_d = loop.center + Vec3(r * s, r * c, 0), dx_d(r * v * c, -r * v * s, 0);
        const Vec3 ddx_d(-r * v * v * s, -r * v * v * c, 0);
        const Eigen::Matrix3d A = (J * J.transpose()).inverse(), turn = dJ * J.transpose();
        const Vec3 forward = A * dx_d, dforward = A * (ddx_d - (turn + turn.transpose()) * forward);
        const Vec3 wanted = forward - loop.gamma * (x - x_d), dwanted = dforward - loop.gamma * (J * dq - dx_d);
        const Vec dq_r = J.transpose() * wanted, ddq_r = dJ.transpose() * wanted + J.transpose() * dwanted;
        const Vec dq_ref = dq_r - loop.K_c.cwiseProduct(q - q_r), ddq_ref = ddq_r - loop.K_c.cwiseProduct(dq - dq_r);
        const Vec sigma = dq - dq_ref, smooth = (dq_ref / loop.v_0).array().tanh();
        regressor(q, dq, dq_ref, ddq_ref);
        const Vec tau = Y * a.template head<10 * N>() + dq_ref.cwiseProduct(a.template segment<N>(10 * N))
                        + smooth.cwiseProduct(a.template tail<N>());
        const Vec e_c = q_c - q_r;
        const Vec dq_c = dq_ref - w_P.cwiseProduct(e_c) + w.cwiseProduct(tau) - w_I.cwiseProduct(z);
        Par moved;
        moved << Y.transpose() * sigma, dq_ref.cwiseProduct(sigma), smooth.cwiseProduct(sigma);
        a -= loop.T * loop.Gamma.cwiseProduct(moved);
        w -= loop.T * loop.Lambda.cwiseProduct(tau).cwiseProduct(sigma);
        w_P += loop.T * loop.Lambda_P.cwiseProduct(e_c).cwiseProduct(sigma);
        w_I += loop.T * loop.Lambda_I.cwiseProduct(z).cwiseProduct(sigma);
        z += loop.T * e_c;
        q_r += loop.T * dq_r;
        a = a.cwiseMax(loop.a_lower).cwiseMin(loop.a_upper);
        w = w.cwiseMax(loop.lower[0]).cwiseMin(loop.upper[0]);
        w_P = w_P.cwiseMax(loop.lower[1]).cwiseMin(loop.upper[1]);
        w_I = w_I.cwiseMax(loop.lower[2]).cwiseMin(loop.upper[2]);
        return dq_c;
    }
};

Plant rate(const Loop &loop, pin::Data &data, const Plant &x, const Vec &dq_c) {
    const Vec q = x.template segment<N>(2 * N), dq = x.template tail<N>(), error = q - x.template head<N>();
    const Vec torque = -loop.K_D.cwiseProduct(dq - dq_c) - loop.K_P.cwiseProduct(error)
                       - loop.K_I.cwiseProduct(x.template segment<N>(N)) - loop.B.cwiseProduct(dq)
                       - loop.D.cwiseProduct((dq / loop.v_0).array().tanh().matrix());
    Plant dx;
    dx << dq_c, error, dq, pin::aba(loop.model, data, q, dq, torque);
    return dx;
}

extern "C" void run(const double *numbers, const double *start, int ticks, int substeps, double *q) {
    const Loop loop{Reader{numbers}};
    Controller controller(loop, start);
    pin::Data data(loop.model);
    Plant x = Eigen::Map<const Plant>(start + P + 5 * N);
    const double h = loop.T / substeps;
    for (int k = 0; k <= ticks; ++k) {
        Eigen::Map<Vec>(q + k * N) = x.template segment<N>(2 * N);
        if (k == ticks) break;
        const Vec dq_c = controller.step(k * loop.T, x.template segment<N>(2 * N), x.template tail<N>(),
                                         x.template head<N>());
        for (int j = 0; j < substeps; ++j) {
            const Plant k1 = rate(loop, data, x, dq_c);
            const Plant k2 = rate(loop, data, x + h / 2 * k1, dq_c);
            const Plant k3 = rate(loop, data, x + h / 2 * k2, dq_c);
            const Plant k4 = rate(loop, data, x + h * k3, dq_c);
            x += h / 6 * (k1 + 2 * (k2 + k3) + k4);
        }
    }
}

template <class F> double seconds(int repeats, F &&f) {
    for (int k = 0; k < repeats / 10 + 1; ++k) f(k);
    const auto begin = std::chrono::steady_clock::now();
    for (int k = 0; k < repeats; ++k) f(k);
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() / repeats;
}

extern "C" void calls(const double *numbers, const double *start, int repeats, double *out) {
    const Loop loop{Reader{numbers}};
    Controller controller(loop, start);
    pin::Data data(loop.model);
    const Vec q0 = Eigen::Map<const Vec>(start + P + 7 * N), z = Vec::Constant(0.3), dz = Vec::Constant(0.1);
    const Vec none = Vec::Zero();
    Vec q = q0, dq = Vec::Constant(0.2);
    const auto move = [&](int k) { q = q0 + Vec::Constant(1e-6 * (k % 1000)); };
    const auto Y = [&](const Vec &v, const Vec &a) -> const auto & {
        return pin::computeJointTorqueRegressor(loop.model, data, q, v, a);
    };
    Regressor sum;
    volatile double sink = 0;
    out[0] = seconds(repeats, [&](int k) { move(k), sink = Y(dq, dz)(0, 0); });
    out[1] = seconds(repeats, [&](int k) {
        move(k);
        sum = Y(none, dz);
        sum += 0.5 * Y(dq + z, none);
        sum -= 0.5 * Y(dq, none);
        sum -= 0.5 * Y(z, none);
        sum += 0.5 * Y(none, none);
        sink = sum(0, 0);
    });
    out[2] = seconds(repeats, [&](int k) { move(k), controller.regressor(q, dq, z, dz), sink = controller.Y(0, 0); });
    out[3] = seconds(repeats, [&](int k) { move(k), sink = pin::aba(loop.model, data, q, dq, dz)[0]; });
    out[4] = seconds(repeats, [&](int k) { move(k), sink = controller.step(1e-3 * k, q, dq, q0)[0]; });
}
