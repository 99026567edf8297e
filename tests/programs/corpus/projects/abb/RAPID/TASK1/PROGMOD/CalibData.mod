%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%

MODULE CalibData
  TASK PERS tooldata gripper:=[TRUE,[[0,0,180],[0.923879533,0,0,0.382683432]],[12.5,[0,0,95],[1,0,0,0],0.2,0.2,0.1]];
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  TASK PERS wobjdata table:=[FALSE,TRUE,"",[[900,-400,350],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  TASK PERS wobjdata fixture:=[FALSE,TRUE,"",[[300,600,200],[1,0,0,0]],[[0,200,30],[0.707106781,0,0,0.707106781]]];
  TASK PERS loaddata part:=[3.1,[0,0,40],[1,0,0,0],0,0,0];
ENDMODULE
