// Deliver the broadcasts of a workload in ns-3, by SimpleNetDevices on a SimpleChannel.
//
// This is a standalone program, which elsewhere.py runs. On a complete graph with constant latency the channel is that
// of ns-3. Otherwise it is `Links`, which also schedules one event per receiver, but only for the neighbours, and each
// after a latency of its own.

#include <cmath>
#include <ctime>
#include <iostream>
#include <iterator>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "ns3/core-module.h"
#include "ns3/network-module.h"

using namespace ns3;

struct Told
{
    double turns, tick, mean, cv;
    unsigned seed;
    std::vector<std::vector<uint32_t>> neighbours;
};

static Told told;
static std::vector<Ptr<SimpleNetDevice>> devices;
static std::vector<std::vector<int64_t>> tables;
static uint64_t delivered = 0;

class Links : public SimpleChannel
{
  public:
    Links() : m_rng(told.seed)
    {
        double variance = std::log1p(told.cv * told.cv);
        m_latency = std::lognormal_distribution<double>(std::log(told.mean) - variance / 2, std::sqrt(variance));
    }

    void Send(Ptr<Packet> p, uint16_t protocol, Mac48Address to, Mac48Address from, Ptr<SimpleNetDevice> sender) override
    {
        for (uint32_t node : told.neighbours[sender->GetNode()->GetId()])
        {
            double latency = told.cv ? m_latency(m_rng) : told.mean;
            Simulator::ScheduleWithContext(node, NanoSeconds(std::llround(latency * 1e9)), &SimpleNetDevice::Receive,
                                           devices[node], p->Copy(), protocol, to, from);
        }
    }

  private:
    std::mt19937_64 m_rng;
    std::lognormal_distribution<double> m_latency;
};

static bool Receive(Ptr<NetDevice> device, Ptr<const Packet> packet, uint16_t, const Address&)
{
    int64_t number;
    packet->CopyData(reinterpret_cast<uint8_t*>(&number), sizeof number);
    int64_t& known = tables[device->GetNode()->GetId()][number % devices.size()];
    known = std::max(known, number);
    delivered++;
    return true;
}

static void Turn(int64_t number)
{
    Ptr<SimpleNetDevice> device = devices[number % devices.size()];
    device->Send(Create<Packet>(reinterpret_cast<uint8_t*>(&number), sizeof number), device->GetBroadcast(), 0);
    if (number + 1 < told.turns)
    {
        Simulator::Schedule(Seconds(told.tick), &Turn, number + 1);
    }
}

int main()
{
    std::string line;
    std::getline(std::cin, line);
    std::istringstream(line) >> told.turns >> told.tick >> told.mean >> told.cv >> told.seed;
    bool complete = true;
    while (std::getline(std::cin, line))
    {
        std::istringstream words(line);
        told.neighbours.emplace_back(std::istream_iterator<uint32_t>(words), std::istream_iterator<uint32_t>());
    }
    GlobalValue::Bind("SchedulerType", StringValue("ns3::PriorityQueueScheduler")); // the fastest of its schedulers here
    size_t size = told.neighbours.size();
    for (const auto& each : told.neighbours)
    {
        complete = complete && each.size() == size - 1;
    }
    Ptr<SimpleChannel> channel = CreateObject<Links>();
    if (complete && !told.cv)
    {
        channel = CreateObject<SimpleChannel>();
    }
    channel->SetAttribute("Delay", TimeValue(Seconds(told.mean)));
    tables.assign(size, std::vector<int64_t>(size, -1));
    for (size_t k = 0; k < size; k++)
    {
        Ptr<Node> node = CreateObject<Node>();
        Ptr<SimpleNetDevice> device = CreateObject<SimpleNetDevice>();
        device->SetAddress(Mac48Address::Allocate());
        node->AddDevice(device);
        device->SetChannel(channel);
        device->SetReceiveCallback(MakeCallback(&Receive));
        devices.push_back(device);
    }
    Simulator::Schedule(Seconds(0), &Turn, int64_t{0});
    std::clock_t begin = std::clock();
    Simulator::Run();
    double seconds = double(std::clock() - begin) / CLOCKS_PER_SEC;
    Simulator::Destroy();
    std::cout << "{\"deliveries\": " << delivered << ", \"seconds\": " << seconds << "}" << std::endl;
}
