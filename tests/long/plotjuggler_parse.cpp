// PlotJuggler's parser of ROS 2 messages: prints the bits of every field, one line a message.
// Arguments: topic, type, file of its definition, file of messages in hexadecimal.
#include <cstring>
#include <fstream>
#include <iostream>
#include <sstream>
#include <vector>

#include "rosx_introspection/ros_parser.hpp"

using namespace RosMsgParser;

int main(int, char** arguments) {
  std::ifstream definition(arguments[3]), messages(arguments[4]);
  std::stringstream text;
  text << definition.rdbuf();
  Parser parser(arguments[1], ROSType(arguments[2]), text.str());
  NanoCDR_Deserializer deserializer;
  FlatMessage flat;
  std::string line, name;
  while (std::getline(messages, line)) {
    std::vector<uint8_t> bytes;
    for (size_t at = 0; at + 1 < line.size(); at += 2) {
      bytes.push_back(std::stoi(line.substr(at, 2), nullptr, 16));
    }
    parser.deserialize({bytes.data(), bytes.size()}, &flat, &deserializer);
    for (auto& [key, value] : flat.value) {
      key.toStr(name);
      std::cout << name << "=";
      if (value.getTypeID() == BuiltinType::STRING) {
        std::cout << value.extract<std::string>() << " ";
        continue;
      }
      double number = value.convert<double>();
      uint64_t bits;
      std::memcpy(&bits, &number, sizeof bits);
      std::cout << std::hex << bits << std::dec << " ";
    }
    std::cout << "\n";
  }
}
