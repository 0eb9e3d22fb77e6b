// A stand-in: figures of a moving average.
#ifndef STAND_IN_STATISTICS
#define STAND_IN_STATISTICS

#include <cstdint>

namespace libstatistics_collector::moving_average_statistics
{
struct StatisticData
{
  double average = 0, min = 0, max = 0, standard_deviation = 0;
  std::uint64_t sample_count = 0;
};
class MovingAverageStatistics
{
public:
  void AddMeasurement(double) {}
  void Reset() {}
  StatisticData GetStatistics() const { return {}; }
};
}  // namespace libstatistics_collector::moving_average_statistics

#endif
