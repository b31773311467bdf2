// One inner solve of the hybrid model with fixed correspondences, by Ceres Solver, as its users would write it: a residual block for each
// vertex, of its nodes and of all weights. `experiments ceres` writes the case, runs this beside our solver, and compares.
//
//   E = sum_i rho(alpha (n_i . (v_i - c_i))^2)                                     rho: Huber, or none
//     + lambda_graph sum_ij |R_i (x_j - x_i) + x_i + t_i - x_j - t_j|^2            directed edges
//     + lambda_blend sum_k w_k^2
//   v_i = sum_j omega_ij (R_j (b_i - x_j) + x_j + t_j),   b_i = neutral_i + sum_k w_k delta_ik
//
// A node has six parameters, angle times axis and translation; all parameters are zero at the start. Ceres minimises E / 2.

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

using Vector = Eigen::Vector3d;
template <class T>
using VectorOf = Eigen::Matrix<T, 3, 1>;
template <class T>
using View = Eigen::Map<const VectorOf<T>>;
using RowMajor3 = Eigen::Matrix<double, 3, 6, Eigen::RowMajor>;

struct Influence {
  int node;
  double weight;
};

struct Case {
  int shapes = 0;
  double alpha = 0, lambda_graph = 0, lambda_blend = 0, huber = 0;
  std::vector<Vector> neutral, delta, target, normal, node;  // delta: by vertex, then by shape
  std::vector<std::vector<Influence>> influences;            // those that are not zero
  std::vector<std::pair<int, int>> edges;
};

// Little endian, as the processors are that Ceres is compared on.
class Reader {
 public:
  explicit Reader(const std::string& path) : file_(path, std::ios::binary) {
    if (!file_) throw std::runtime_error(path + ": cannot be opened");
  }
  template <class T>
  std::vector<T> Many(size_t count) {
    std::vector<T> items(count);
    file_.read(reinterpret_cast<char*>(items.data()), static_cast<std::streamsize>(count * sizeof(T)));
    if (!file_) throw std::runtime_error("the case ends too early");
    return items;
  }
  std::vector<Vector> Points(size_t count) {
    const auto numbers = Many<double>(3 * count);
    std::vector<Vector> points(count);
    for (size_t i = 0; i < count; ++i) points[i] = Vector(numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]);
    return points;
  }

 private:
  std::ifstream file_;
};

// The fields as `Case::write_binary` of experiments/src/ceres.rs has them.
Case ReadCase(const std::string& path) {
  Reader in(path);
  const auto magic = in.Many<char>(8);
  if (std::string(magic.begin(), magic.end()) != "NRCASE01") throw std::runtime_error(path + ": not a case");
  const auto counts = in.Many<uint32_t>(5);
  const size_t vertices = counts[0], nodes = counts[1], most = counts[2], edges = counts[4];
  const auto scalars = in.Many<double>(4);
  Case c;
  c.shapes = static_cast<int>(counts[3]);
  c.alpha = scalars[0], c.lambda_graph = scalars[1], c.lambda_blend = scalars[2], c.huber = scalars[3];
  c.neutral = in.Points(vertices);
  c.delta = in.Points(vertices * counts[3]);
  c.target = in.Points(vertices);
  c.normal = in.Points(vertices);
  c.node = in.Points(nodes);
  const auto influence = in.Many<uint32_t>(vertices * most);
  const auto weight = in.Many<double>(vertices * most);
  c.influences.resize(vertices);
  for (size_t i = 0; i < vertices * most; ++i) {
    if (influence[i] >= nodes) throw std::runtime_error("an influence names no node");
    if (weight[i] > 0) c.influences[i / most].push_back({static_cast<int>(influence[i]), weight[i]});
  }
  const auto edge = in.Many<uint32_t>(2 * edges);
  for (size_t e = 0; e < edges; ++e) {
    if (edge[2 * e] >= nodes || edge[2 * e + 1] >= nodes) throw std::runtime_error("an edge names no node");
    c.edges.emplace_back(static_cast<int>(edge[2 * e]), static_cast<int>(edge[2 * e + 1]));
  }
  return c;
}

// ---- What automatic differentiation takes ----

template <class T>
VectorOf<T> Rotated(const T* angle_axis, const VectorOf<T>& p) {
  VectorOf<T> rotated;
  ceres::AngleAxisRotatePoint(angle_axis, p.data(), rotated.data());
  return rotated;
}

struct PointToPlane {
  const Case& c;
  int vertex;

  template <class T>
  bool operator()(T const* const* parameters, T* residual) const {
    const auto& influences = c.influences[vertex];
    VectorOf<T> blended = c.neutral[vertex].cast<T>();
    for (int k = 0; k < c.shapes; ++k) {
      const Vector& d = c.delta[static_cast<size_t>(vertex) * c.shapes + k];
      const T& w = parameters[influences.size()][k];
      for (int a = 0; a < 3; ++a) blended[a] += w * d[a];
    }
    VectorOf<T> v = VectorOf<T>::Zero();
    for (size_t q = 0; q < influences.size(); ++q) {
      const Vector& x = c.node[influences[q].node];
      const VectorOf<T> from_node = blended - x.cast<T>();
      const VectorOf<T> moved = Rotated(parameters[q], from_node) + x.cast<T>() + View<T>(parameters[q] + 3);
      v += moved * T(influences[q].weight);
    }
    residual[0] = std::sqrt(c.alpha) * c.normal[vertex].cast<T>().dot(v - c.target[vertex].cast<T>());
    return true;
  }
};

struct GraphEdge {
  Vector from, to;
  double root;  // of lambda_graph

  template <class T>
  bool operator()(const T* i, const T* j, T* residual) const {
    const VectorOf<T> along = (to - from).cast<T>();
    const VectorOf<T> gap = Rotated(i, along) + View<T>(i + 3) - along - View<T>(j + 3);
    for (int a = 0; a < 3; ++a) residual[a] = root * gap[a];
    return true;
  }
};

struct SmallWeights {
  int shapes;
  double root;  // of lambda_blend

  template <class T>
  bool operator()(T const* const* parameters, T* residuals) const {
    for (int k = 0; k < shapes; ++k) residuals[k] = root * parameters[0][k];
    return true;
  }
};

// ---- The same with derivatives by hand ----

// The transpose of the left Jacobian of SO(3) at `a`, which says how R(a) turns as `a` changes.
class TransposedJacobian {
 public:
  explicit TransposedJacobian(const Vector& a) : a_(a) {
    const double t2 = a.squaredNorm(), t = std::sqrt(t2);
    first_ = t2 < 1e-8 ? 0.5 - t2 / 24 : (1 - std::cos(t)) / t2;
    second_ = t2 < 1e-8 ? 1.0 / 6 - t2 / 120 : (t - std::sin(t)) / (t2 * t);
  }
  Vector operator*(const Vector& g) const {
    const Vector turned = a_.cross(g);
    return g - first_ * turned + second_ * a_.cross(turned);
  }

 private:
  Vector a_;
  double first_, second_;
};

Eigen::Matrix3d Rotation(const double* angle_axis) {
  Eigen::Matrix3d r;
  ceres::AngleAxisToRotationMatrix(angle_axis, r.data());
  return r;
}

class AnalyticPointToPlane : public ceres::CostFunction {
 public:
  AnalyticPointToPlane(const Case& c, int vertex) : c_(c), vertex_(vertex) {
    mutable_parameter_block_sizes()->assign(c.influences[vertex].size(), 6);
    if (c.shapes > 0) mutable_parameter_block_sizes()->push_back(c.shapes);
    set_num_residuals(1);
  }

  bool Evaluate(double const* const* parameters, double* residual, double** jacobians) const override {
    const auto& influences = c_.influences[vertex_];
    const Vector* delta = c_.delta.data() + static_cast<size_t>(vertex_) * c_.shapes;
    const Vector normal = std::sqrt(c_.alpha) * c_.normal[vertex_];
    Vector blended = c_.neutral[vertex_];
    for (int k = 0; k < c_.shapes; ++k) blended += parameters[influences.size()][k] * delta[k];
    Vector v = Vector::Zero(), of_blended = Vector::Zero();  // the residual's derivative by the blended vertex
    for (size_t q = 0; q < influences.size(); ++q) {
      const double* node = parameters[q];
      const double weight = influences[q].weight;
      const Vector& x = c_.node[influences[q].node];
      const Eigen::Matrix3d r = Rotation(node);
      const Vector turned = r * (blended - x);
      v += weight * (turned + x + View<double>(node + 3));
      of_blended += weight * (r.transpose() * normal);
      if (jacobians && jacobians[q]) {
        const Vector angles = TransposedJacobian(View<double>(node)) * Vector(turned.cross(normal));
        Eigen::Map<Vector>{jacobians[q]} = weight * angles;
        Eigen::Map<Vector>{jacobians[q] + 3} = weight * normal;
      }
    }
    residual[0] = normal.dot(v - c_.target[vertex_]);
    if (c_.shapes > 0 && jacobians && jacobians[influences.size()]) {
      for (int k = 0; k < c_.shapes; ++k) jacobians[influences.size()][k] = of_blended.dot(delta[k]);
    }
    return true;
  }

 private:
  const Case& c_;
  int vertex_;
};

class AnalyticGraphEdge : public ceres::SizedCostFunction<3, 6, 6> {
 public:
  explicit AnalyticGraphEdge(const GraphEdge& edge) : edge_(edge) {}

  bool Evaluate(double const* const* parameters, double* residual, double** jacobians) const override {
    const double *i = parameters[0], *j = parameters[1];
    const Vector along = edge_.to - edge_.from, turned = Rotation(i) * along;
    Eigen::Map<Vector>{residual} = edge_.root * (turned + View<double>(i + 3) - along - View<double>(j + 3));
    if (jacobians && jacobians[0]) {
      Eigen::Map<RowMajor3> of_i{jacobians[0]};
      const TransposedJacobian left{View<double>(i)};
      for (int a = 0; a < 3; ++a) {
        const Vector angles = left * Vector(turned.cross(Vector::Unit(a)));
        of_i.block<1, 3>(a, 0) = edge_.root * angles.transpose();
      }
      of_i.rightCols<3>() = edge_.root * Eigen::Matrix3d::Identity();
    }
    if (jacobians && jacobians[1]) {
      Eigen::Map<RowMajor3> of_j{jacobians[1]};
      of_j.leftCols<3>().setZero();
      of_j.rightCols<3>() = -edge_.root * Eigen::Matrix3d::Identity();
    }
    return true;
  }

 private:
  GraphEdge edge_;
};

class AnalyticSmallWeights : public ceres::CostFunction {
 public:
  explicit AnalyticSmallWeights(const SmallWeights& term) : term_(term) {
    mutable_parameter_block_sizes()->push_back(term.shapes);
    set_num_residuals(term.shapes);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    term_(parameters, residuals);
    if (jacobians && jacobians[0]) {
      Eigen::Map<Eigen::MatrixXd> square{jacobians[0], term_.shapes, term_.shapes};
      square.setIdentity();
      square *= term_.root;
    }
    return true;
  }

 private:
  SmallWeights term_;
};

// ---- The problem ----

struct Unknowns {
  std::vector<double> nodes, weights;
};

void Build(const Case& c, bool analytic, Unknowns& x, ceres::Problem& problem) {
  x.nodes.assign(6 * c.node.size(), 0.0);
  x.weights.assign(c.shapes, 0.0);
  const auto node = [&x](int j) { return x.nodes.data() + 6 * j; };
  for (int i = 0; i < static_cast<int>(c.neutral.size()); ++i) {
    std::vector<double*> blocks;
    for (const Influence& influence : c.influences[i]) blocks.push_back(node(influence.node));
    if (c.shapes > 0) blocks.push_back(x.weights.data());
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticPointToPlane(c, i);
    } else {
      auto* automatic = new ceres::DynamicAutoDiffCostFunction<PointToPlane, 8>(new PointToPlane{c, i});
      for (size_t q = 0; q < c.influences[i].size(); ++q) automatic->AddParameterBlock(6);
      if (c.shapes > 0) automatic->AddParameterBlock(c.shapes);
      automatic->SetNumResiduals(1);
      cost = automatic;
    }
    problem.AddResidualBlock(cost, c.huber > 0 ? new ceres::HuberLoss(c.huber) : nullptr, blocks);
  }
  for (const auto& [i, j] : c.edges) {
    const GraphEdge edge{c.node[i], c.node[j], std::sqrt(c.lambda_graph)};
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticGraphEdge(edge);
    } else {
      cost = new ceres::AutoDiffCostFunction<GraphEdge, 3, 6, 6>(new GraphEdge(edge));
    }
    problem.AddResidualBlock(cost, nullptr, node(i), node(j));
  }
  if (c.shapes > 0) {
    const SmallWeights term{c.shapes, std::sqrt(c.lambda_blend)};
    ceres::CostFunction* cost = nullptr;
    if (analytic) {
      cost = new AnalyticSmallWeights(term);
    } else {
      auto* automatic = new ceres::DynamicAutoDiffCostFunction<SmallWeights, 8>(new SmallWeights(term));
      automatic->AddParameterBlock(c.shapes);
      automatic->SetNumResiduals(c.shapes);
      cost = automatic;
    }
    problem.AddResidualBlock(cost, nullptr, x.weights.data());
  }
}

const std::map<std::string, ceres::LinearSolverType> kSolvers = {
    {"dense-schur", ceres::DENSE_SCHUR},
    {"sparse-schur", ceres::SPARSE_SCHUR},
    {"sparse-normal-cholesky", ceres::SPARSE_NORMAL_CHOLESKY},
};

int main(int count, char** arguments) {
  const std::string derivatives = count == 5 ? arguments[2] : "";
  const auto solver = kSolvers.find(count == 5 ? arguments[3] : "");
  const int iterations = count == 5 ? std::atoi(arguments[4]) : 0;
  if ((derivatives != "automatic" && derivatives != "analytic") || solver == kSolvers.end() || iterations < 1) {
    std::fprintf(stderr, "usage: ceres_case CASE.bin automatic|analytic dense-schur|sparse-schur|sparse-normal-cholesky ITERATIONS\n");
    return 1;
  }
  try {
    const Case c = ReadCase(arguments[1]);
    Unknowns x;
    ceres::Problem problem;
    Build(c, derivatives == "analytic", x, problem);
    ceres::Solver::Options options;
    options.num_threads = 1;
    options.linear_solver_type = solver->second;
    options.max_num_iterations = iterations;
    // As `solver-case` has them.
    options.function_tolerance = 1e-12;
    options.parameter_tolerance = 1e-14;
    options.gradient_tolerance = 1e-14;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) throw std::runtime_error(summary.message);
    const auto steps = std::max<size_t>(summary.iterations.size(), 2) - 1;  // the first of them is the start
    std::printf("{\"initial_cost\": %.17g, \"final_cost\": %.17g, \"iterations\": %zu, \"seconds_per_iteration\": %.9g}\n",
                summary.initial_cost, summary.final_cost, steps, summary.minimizer_time_in_seconds / steps);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "error: %s\n", e.what());
    return 2;
  }
}
