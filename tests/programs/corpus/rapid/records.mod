MODULE Records
  RECORD part
    robtarget grasp;
    robtarget drop;
    string label;
  ENDRECORD
  PERS tooldata gun:=[TRUE,[[97.4,0,223.1],[0.924,0,0.383,0]],[5,[23,0,75],[1,0,0,0],0,0,0]];
  PERS part left:=[<11|gun|wobj0>,<12|gun|wobj0>,"left; [[1,2,3]]"];
  ALIAS robtarget place;
  CONST place pWait:=<13|gun|wobj0>;
  PROC serve(num which,\PERS wobjdata WObj)
    IF which=1 MoveL left.grasp,v100,fine,gun;
    MoveL left.drop,v100,fine,gun;
    MoveJ pWait,v100,fine,gun;
  ENDPROC
ENDMODULE
